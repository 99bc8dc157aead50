"""Traces from a run: exact where a scenario reads them again."""

from __future__ import annotations

from pathlib import Path

import pytest
from tool import invoke

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.logs.link_traces import link_trace, write_traces
from fleet.logs.open_log import Log, open_log
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.trace_table import read_trace
from fleet.scenario.text.yaml_reader import Source, plain, read
from fleet.scenario.text.yaml_writer import inline

COMMON = ["checks={}"]
EVENTS = (
    "faults=[{at: 500 ms, for: 400 ms, partition: halves}, {at: 1 s, for: 300 ms, slow: {vehicles: 2, by: 5 ticks}}]"
)


def run(scenario: Scenario, out: Path) -> Log:
    return open_log(execute(scenario, Options(out, in_process=True, quiet=True)).directory / "run.mcap")


def packets(log: Log, src: int, dst: int) -> list[tuple[int, bool, float, float]]:
    """(seq, delivered or still on the way, due, delay) of each packet that was not lost, in order."""
    topic = log[f"link/{src}-{dst}"]
    rows = zip(
        topic["seq"].tolist(), topic["fate"].tolist(), topic["due"].tolist(), topic["delay"].tolist(), strict=True
    )
    return sorted(
        (seq, fate == "delivered", due, delay) for seq, fate, due, delay in rows if fate in ("delivered", "in flight")
    )


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("rough-sea", ["duration=3 s", "network.links={'*': delay 200ms 50ms loss 30% rate 8kbit}"]),
        ("rough-sea", ["duration=2 s", EVENTS]),
        ("average", ["duration=2 s", "network.links={'*': delay 70ms 20ms distribution normal loss 20%}"]),
        ("acoustic-s2c", ["duration=12 s"]),
    ],
)
def test_a_round_trip_is_exact(name: str, overrides: list[str], tmp_path: Path) -> None:
    """Run, traces, run with the traces: each packet has the same fate and the same delay, whatever the network was."""
    first = run(load_scenario(name, [*COMMON, *overrides]), tmp_path / "first")
    files = write_traces(first, tmp_path / "traces")
    links = plain(read(Source("links.yaml", files[-1].read_text()))[0])["links"]
    period = load_scenario(name, overrides).spec.network.period
    network = {"period": f"{period} ns", "payload": load_scenario(name).spec.network.payload, "links": links}
    inside = {link: entry | {"trace": str(tmp_path / "traces" / entry["trace"])} for link, entry in links.items()}
    again = load_scenario(name, [*COMMON, *overrides, f"network={inline(network | {'links': inside})}"])
    assert again.acoustic is None
    second = run(again, tmp_path / "second")
    for src, dst in first.links:
        if name != "acoustic-s2c":  # there, what is on the way at the end has no delay yet
            assert packets(second, src, dst) == packets(first, src, dst)
        assert link_trace(second[f"link/{src}-{dst}"], again.tick_ns) == read_trace(
            tmp_path / "traces" / f"{src}-{dst}.csv"
        )


def test_copies_and_damage_make_one_row_each(tmp_path: Path) -> None:
    """The first whole copy counts; a packet that arrives damaged is lost to its receiver."""
    scenario = load_scenario(
        "paper", [*COMMON, "duration=3 s", "network.links={'*': delay 50ms 30ms duplicate 50% corrupt 30%}"]
    )
    log = run(scenario, tmp_path)
    topic = log["link/1-2"]
    rows = link_trace(topic, scenario.tick_ns).rows
    assert len(rows) == 30
    fates = zip(
        topic["seq"].tolist(), topic["due"].tolist(), topic["delay"].tolist(), topic["corrupted"].tolist(), strict=True
    )
    whole: dict[int, tuple[float, float]] = {}
    for seq, due, delay, corrupted in fates:
        if not corrupted:
            whole[seq] = min((due, delay), whole.get(seq, (due, delay)))
    assert {n for n, row in enumerate(rows) if row.delivered} == set(whole)
    assert 0 < len(whole) < 30
    assert all(rows[n].delay_ns == round(delay * 1e9) for n, (_, delay) in whole.items())


def test_on_the_command_line(tmp_path: Path) -> None:
    log = run(load_scenario("paper", [*COMMON, "duration=1 s"]), tmp_path / "paper").path
    arguments = ["export", str(log), "--traces", str(tmp_path / "t")]
    assert (done := invoke(*arguments)).exit_code == 0
    assert done.stdout.split()[-1] == str(tmp_path / "t" / "links.yaml")
    assert (tmp_path / "t" / "1-2.csv").read_text().startswith("time [s],delivered,delay [ms]\n0,1,0\n0.1,1,0\n")
    assert "already holds 1-2.csv" in invoke(*arguments).output
