"""From a recording to the network that made it: numbers show what was lost, and a fit finds what lost it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from tool import invoke

from fleet.addons.robots.field_traces import FieldSelection, RecordedMessage, trace_of, write_field_traces
from fleet.addons.robots.link_fit import fit
from fleet.addons.robots.ros2.rmw import RmwAttachment, pack
from fleet.errors import FleetError
from fleet.mcap.writer import McapWriter
from fleet.replay.capture import TrafficWriter
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.trace_table import TraceTable, read_trace
from fleet.scenario.text.yaml_writer import inline
from netem.limits import TRACE
from netem.relay import Relay
from netem.robot_message import PUT, RobotMessage
from netem.wire.open_bus import ZenohSample

WALL_NS = 1_764_000_000 * 10**9
STACK = ROOT / "docs" / "examples" / "field_network" / "stack.yaml"
KEY = "auv1/status"
COUNTED = FieldSelection(sequence="seq")


def sample(payload: bytes, stamp_ns: int | None, attachment: bytes | None = None, key: str = KEY) -> ZenohSample:
    return ZenohSample(key, payload, False, "application/json", attachment, stamp_ns)


def record(path: Path, samples: list[tuple[int, ZenohSample]]) -> Path:
    writer = TrafficWriter(path, ["**"])
    for at_ns, one in samples:
        writer.add(one, WALL_NS + at_ns)
    writer.close()
    return path


def traces(recording: Path, selection: FieldSelection = COUNTED) -> tuple[list[TraceTable], list[str]]:
    said: list[str] = []
    folder = recording.parent / "links"
    files = write_field_traces(recording, folder, selection, force=True, say=said.append, on_progress=lambda _: None)
    return [read_trace(file) for file in files], said


def through(scenario: Scenario, count: int, every_ns: int) -> Iterator[tuple[int, ZenohSample]]:
    """What the second node records of messages that the first sends through the network of a scenario."""
    relay = Relay(scenario.netem_config, 0)
    for n in range(count):
        at_ns = n * every_ns
        relay.take(RobotMessage(1, PUT, KEY, b'{"seq": %d}' % n, at_ns))
        for due in relay.due_messages(at_ns):
            yield due.due_ns, sample(due.payload, WALL_NS + due.message.at_ns)


def test_a_recording_becomes_the_network_that_made_it(tmp_path: Path) -> None:
    """Record through a known network, export, fit; and record through the fitted one: both lose and delay alike."""
    known = load_scenario(str(STACK), [])
    every_ns = 100_000_000
    (trace,), _ = traces(record(tmp_path / "first.mcap", list(through(known, 8_000, every_ns))))
    found = fit(trace, 2)
    assert found.interval_ns == pytest.approx(every_ns, rel=0.01)
    assert [c.loss for c in found.conditions] == pytest.approx([0.02, 0.75], abs=0.06)
    assert list(found.mean_ns) == pytest.approx([8e9, 2e9], rel=0.25)
    assert [c.delay_ns / 1e6 for c in found.conditions] == pytest.approx([80, 400], rel=0.05)
    assert [c.jitter_ns / 1e6 for c in found.conditions] == pytest.approx([15, 60], rel=0.2)

    again = load_scenario(str(STACK), [f"network.links={inline({'auv1->buoy': found.section()})}"])
    (second,), _ = traces(record(tmp_path / "second.mcap", list(through(again, 8_000, every_ns))))
    (lost, mean, tail), (lost_again, mean_again, tail_again) = map(measures, (trace, second))
    assert lost_again == pytest.approx(lost, abs=0.03)
    assert mean_again == pytest.approx(mean, rel=0.1)
    assert tail_again == pytest.approx(tail, rel=0.15)


def measures(table: TraceTable) -> tuple[float, float, float]:
    """The share that was lost, the mean delay of the others, and what one in fifty of them exceeds."""
    delays = [row.delay_ns for row in table.rows if row.delay_ns is not None]
    return 1.0 - len(delays) / len(table.rows), float(np.mean(delays)), float(np.quantile(delays, 0.98))


def test_losses_that_come_alone_become_one_condition(tmp_path: Path) -> None:
    network = "network.links={auv1->buoy: delay 300ms 50ms distribution normal loss 20%}"
    known = load_scenario(str(STACK), [network])
    path = record(tmp_path / "day.mcap", list(through(known, 5_000, 100_000_000)))
    assert invoke("export", path, "--traces", tmp_path / "links", "--sequence", "seq").exit_code == 0
    fitted = invoke("fit", tmp_path / "links" / "auv1-status.csv", "--states", "1")
    assert fitted.exit_code == 0, fitted.output
    (condition,) = fit(read_trace(tmp_path / "links" / "auv1-status.csv"), 1).conditions
    assert condition.loss == pytest.approx(0.2, abs=0.02)
    assert condition.delay_ns == pytest.approx(300e6, rel=0.01)
    assert condition.jitter_ns == pytest.approx(50e6, rel=0.05)
    assert "delay 3" in fitted.stdout and "loss" in fitted.stdout


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3_000_000)), min_size=1, max_size=30))
def test_every_number_between_the_first_and_the_last_is_a_row(sent: list[tuple[int, int]]) -> None:
    """In whatever order, and however often messages arrive: the first copy counts, and times never go back."""
    arrivals = sorted(
        (RecordedMessage(n, n * 1_000_000, n * 1_000_000 + late) for n, late in sent), key=lambda a: a.at_ns
    )
    numbers = [n for n, _, _ in arrivals if n is not None]
    table = trace_of(arrivals, numbers, 0)
    assert [row.delivered for row in table.rows] == [n in numbers for n in range(min(numbers), max(numbers) + 1)]
    assert [row.time_ns for row in table.rows] == [n * 1_000_000 for n in range(min(numbers), max(numbers) + 1)]
    if "delay" in table.columns:
        best = {n: min(late for m, late in sent if m == n) for n in numbers}
        assert [row.delay_ns for row in table.rows if row.delivered] == [best[n] for n in sorted(best)]


def flags(table: TraceTable) -> str:
    return "".join(str(int(row.delivered)) for row in table.rows)


def test_each_publisher_of_ros_counts_on_its_own_and_says_when_it_sent(tmp_path: Path) -> None:
    samples = [
        (n * 10**8 + 5_000_000, sample(b"x", None, pack(RmwAttachment(n, WALL_NS + n * 10**8, bytes([who] * 16)))))
        for n in range(1, 7)
        for who in (1, 2)
        if (n, who) not in ((2, 1), (4, 2), (5, 2))
    ]
    found, said = traces(record(tmp_path / "ros.mcap", samples), FieldSelection())
    assert [flags(table) for table in found] == ["101111", "111001"]
    assert {row.delay_ns for table in found for row in table.rows if row.delivered} == {5_000_000}
    assert said[0].startswith("auv1/status 01010101: 6 messages in 0.5 s, 16.7 % lost, up to 1 in a row")


def test_a_period_shows_gaps_without_numbers(tmp_path: Path) -> None:
    times = (0.0, 1.1, 1.9, 5.0, 6.1)
    path = record(tmp_path / "p.mcap", [(round(t * 1e9), sample(b"", None)) for t in times])
    (table,), (said,) = traces(path, FieldSelection(period_ns=10**9))
    assert (flags(table), table.columns) == ("1110011", ("time", "delivered"))
    assert "no time of sending, so no delay" in said
    for nothing in (FieldSelection(), COUNTED):
        with pytest.raises(FleetError, match="give --sequence FIELD or --period TIME"):
            traces(path, nothing)


def test_a_sender_that_begins_anew_loses_nothing_by_it(tmp_path: Path) -> None:
    numbers = [*range(500, 510), 0, 1, 3]
    path = record(tmp_path / "r.mcap", [(n * 10**8, sample(b'{"seq": %d}' % k, None)) for n, k in enumerate(numbers)])
    (table,), _ = traces(path)
    assert flags(table) == "1" * 12 + "01"


def test_the_sequence_of_another_recorder_tells_gaps(tmp_path: Path) -> None:
    """MCAP has a counter for them; that of `fleet record` counts arrivals."""
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, "")
        channel = writer.channel("odom", "json", 0, {})
        for n in (3, 4, 6):
            writer.message(channel, WALL_NS + n * 10**8 + 7, WALL_NS + n * 10**8, n, b"{}")
        writer.finish()
    (table,), said = traces(path, FieldSelection())
    assert flags(table) == "1101"
    assert "if its recorder counts arrivals there, no loss shows" in said[0]
    (table,), _ = traces(path, FieldSelection(period_ns=5 * 10**7))
    assert flags(table) == "1010001"


def test_clocks_that_disagree_are_told(tmp_path: Path) -> None:
    early = [(n * 10**8, sample(b'{"seq": %d}' % n, WALL_NS + n * 10**8 + 3_000_000)) for n in range(4)]
    (table,), said = traces(record(tmp_path / "c.mcap", early))
    assert {row.delay_ns for row in table.rows} == {0}
    assert "4 messages arrived before they were sent, by up to 3 ms" in said[1]


def test_a_gap_longer_than_a_trace_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.robots.field_traces.TRACE", TRACE._replace(items=1000))
    far = [(n, sample(b'{"seq": %d}' % k, None)) for n, k in enumerate((0, 10**15))]
    (table,), said = traces(record(tmp_path / "far.mcap", far))
    assert len(table.rows) == 1000
    assert "only the first 1000 of 1000000000000001 messages" in said[1]


def test_keys_are_chosen(tmp_path: Path) -> None:
    both = [(n, sample(b'{"seq": %d}' % n, None, key=key)) for n in range(3) for key in (KEY, "auv2/status")]
    path = record(tmp_path / "two.mcap", both)
    chosen = invoke("export", path, "--traces", tmp_path / "t", "--sequence", "seq", "--topics", "auv2/*")
    assert [Path(line).name for line in chosen.stdout.split()] == ["auv2-status.csv"]
