"""The same seed gives the same bytes: whatever runs it, in whatever order it starts, wherever and whenever."""

from __future__ import annotations

import getpass
import re
import socket
from collections.abc import Callable, Iterator
from errno import EMFILE
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fault_histories import EVERYTHING
from first_difference import assert_same_bytes, decode, first_difference
from in_process_runs import Alone, log_of, recorded
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from spawned import fleet

from fleet.execution.directory import RunDirectory
from fleet.execution.wiring import Wiring
from fleet.mcap.reader import LogReader, digest
from fleet.repeat.verify import verification_lines, verify
from fleet.result.result import Status
from netem.wire.vehicle_bus import Ends

SHARED = "agents.per_process=3"  # of four: two and two
CHECKS = (
    "checks={qp_infeasible: {at_most: 0}, ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, "
    "deaths: waived}"
)
NOISE = [
    "sensors.position_noise=5 cm",
    "sensors.angle_noise=0.5 deg",
    "sensors.velocity_noise=1 cm/s",
    "sensors.rate_noise=0.1 deg/s",
]
ROUGH = "network.links={'*': 'delay 200ms 50ms loss 30%'}"

INSTRUMENTS = (
    "faults=[{at: 1 s, for: 1 s, dvl: {lost: 50 %, jump: 10 cm/s}}, {at: 1 s, compass: {bias: 1 deg}}, "
    "{at: 500 ms, fix: {jump: 2 m, chance: 50 %}}]"
)

CHANGING = (
    "network.links={'*': {states: {good: {mean: 300 ms}, bad: {condition: loss 50% rate 2kbit, mean: 200 ms}}, "
    'together: true}, 1->2: {trace: "time [s],delivered,delay [ms]\\n0,1,50\\n0.3,0,\\n0.4,1,120.5\\n", '
    "loop: true, offset: random}}"
)

RADIO = "network.radios={'1': rate 12kbit limit 3, '2,3': rate 20kbit}"

CLOCKS = "agent.clock={drift: {sigma: 2000 ppm}, offset: {mean: 5 ms, sigma: 30 ms}}"
CLOCK_FAULTS = (
    "faults=[{at: 1 s, for: 1 s, clock: {vehicles: 2, step: -200 ms, drift: 1e4 ppm}}, {at: 1.5 s, clock: {step: 1 s}}]"
)
HELD = "faults=[{at: 1 s, for: 1 s, hold: 1->2}, {at: 2 s, for: 1 s, duplicate: {links: 2->3, after: 500 ms}}]"
TRIGGER = "triggers=[{when: {topic: control.leads, above: 0}, for: 1 s, fault: {pause: itself}}]"
SLOTS = "network.acoustic={modem: s2c, mac: tdma, slot: 1.4 s, guard: 1.05 s}"

ACOUSTIC = (
    "faults=[{at: 1.5 s, for: 2 s, kill: 3}, {at: 2 s, for: 2 s, pause: 2}, {at: 3 s, for: 2 s, mute: 1}, "
    "{at: 4 s, for: 2 s, slow: {vehicles: 4, by: 30 ticks}}, {at: 5 s, for: 2 s, link 1->2: loss 50% delay 300ms}]"
)
RANGING = "network.acoustic.ranging={method: two-way, noise: 1 m, outliers: {probability: 10 %}}"


class Row(NamedTuple):
    """A mechanism that could make two runs differ: the scenario that has it, and the ways that the quick tests go."""

    scenario: str
    changes: tuple[str, ...]
    quick: str


# Each row adds something: nothing; loss, jitter and the disturbance; draws in the world process; frames that are not
# sent every tick, and an end tick between two of them; a last round that is cut; the tightest coupling there is;
# estimates in place of the truth; a graph in which vehicles hear more than one other, and numbers of two digits; links
# that change by themselves, behind a radio; a QP at every tick; clocks that are drawn, drift, and are set, of agents,
# modems and protocols; vehicles that do not move, packets that are held or come twice, and a fault that an agent's
# report begins; agents that are ended, suspended, slowed and started again; the same in water, with ranges.
ROWS = {
    "paper": Row("paper", ("duration=4 s",), "verified"),
    "rough-sea": Row("rough-sea", ("duration=6 s",), "again distributed exact"),
    "sensor noise": Row("paper", ("duration=3 s", *NOISE), ""),
    "thinned log": Row("rough-sea", ("duration=3 s", "log.every=7 ticks", "log.pose=21 ticks"), "verified paced"),
    "short last round": Row("paper", ("duration=3.07 s", ROUGH), ""),
    "a round per tick": Row("paper", ("duration=2 s", "network.period=10 ms", ROUGH), "hosted"),
    "states and a trace": Row("paper", ("duration=3 s", CHANGING, RADIO), ""),
    "kept apart": Row("crossing", ("duration=3 s", "keep_apart.distance=25 m"), "distributed"),
    "dead reckoning": Row("dead-reckoning", ("duration=3 s", INSTRUMENTS, "log.every=3 ticks"), "distributed"),
    "clocks": Row("rough-sea", ("duration=3 s", CLOCKS, CLOCK_FAULTS), ""),
    "clocks and slots": Row("acoustic-s2c", ("duration=6 s", SLOTS, CLOCKS, CLOCK_FAULTS), "distributed"),
    "clocks of a protocol": Row("election", ("duration=3 s", CLOCKS, CLOCK_FAULTS), "again"),
    "held and triggered": Row("election", ("duration=5 s", "moored=true", HELD, TRIGGER), "distributed verified"),
    "twelve in a ring": Row("paper", ("vehicles=12", "graph.shape=ring", "duration=2 s", *NOISE, ROUGH), ""),
    "every fault": Row("paper", ("duration=2 s", ROUGH, EVERYTHING), "distributed hosted verified"),
    "faults in water": Row("acoustic-s2c", ("duration=8 s", RANGING, ACOUSTIC, "on_death=continue"), "distributed"),
}
# The world hosts the router, so those before it knock at a door that is not there yet.
ORDERS: dict[str, Callable[[list[str]], list[str]]] = {
    "world last": lambda roles: roles[::-1],
    "agents first": lambda roles: sorted(roles),
}


def run(out: Path, row: str, *more: str, **options: Any) -> Path:
    """The log of one run of a row."""
    result = recorded(out, ROWS[row].scenario, CHECKS, *ROWS[row].changes, *more, **({"in_process": False} | options))
    assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
    return log_of(result)


def once(alone: Alone, row: str, *more: str) -> Path:
    """The log of a row in this process, made once."""
    return log_of(alone(ROWS[row].scenario, CHECKS, *ROWS[row].changes, *more))


def again(row: str, out: Path, alone: Alone) -> None:
    """Nothing is left over from a run in one process, or from one between, that the next one sees."""
    assert_same_bytes(once(alone, row), run(out, row, in_process=True))


def distributed(row: str, out: Path, alone: Alone) -> None:
    """Processes and a plain loop write the same file, so no scheduling, no order of arrival and no order of starts
    reaches a result. Every distributed run schedules differently, so each is a new sample of that."""
    assert_same_bytes(once(alone, row), run(out, row, wiring=Wiring(start_order=ORDERS["world last"])))


def agents_first(row: str, out: Path, alone: Alone) -> None:
    """The same in another order of starts."""
    assert_same_bytes(once(alone, row), run(out, row, wiring=Wiring(start_order=ORDERS["agents first"])))


def hosted(row: str, out: Path, alone: Alone) -> None:
    """Agents that share a process; the scenario in the log says that they do, so its bytes are compared with it."""
    assert_same_bytes(once(alone, row, SHARED), run(out, row, SHARED))
    assert digest(once(alone, row, SHARED)) == digest(once(alone, row))


def paced(row: str, out: Path, alone: Alone) -> None:
    """Grants by the wall clock come in other portions than grants ahead of it; neither is a result."""
    assert_same_bytes(once(alone, row), run(out, row, in_process=True, speed=6.0))
    assert_same_bytes(once(alone, row), run(out, row, speed=4.0))


def verified(row: str, out: Path, alone: Alone) -> None:
    """`fleet verify` makes the run again from what its log says of it."""
    log = once(alone, row)
    found = verify(log.parent)
    assert (found.reproduced, found.messages) == (True, sum(1 for _ in LogReader(log))), verification_lines(found)


def exact(row: str, out: Path, alone: Alone) -> None:
    """The formula gives the gains that PIQP confirms; the scenario that the log holds differs."""
    assert digest(once(alone, row)) == digest(once(alone, row, "guidance.solver=exact"))


WAYS = {way.__name__: way for way in (again, distributed, agents_first, hosted, paced, verified, exact)}


def cells() -> Iterator[Any]:
    """Each row in each way; all but those that it names for the quick tests are slow."""
    for row, way in product(ROWS, WAYS):
        marks = [] if way in ROWS[row].quick.split() else [pytest.mark.slow]
        yield pytest.param(row, way, marks=marks, id=f"{row}, {way}")


@pytest.mark.parametrize(("row", "way"), [*cells()])
def test_same_bytes(row: str, way: str, tmp_path: Path, alone: Alone) -> None:
    """Whatever makes a run, in whatever order it starts, wherever and whenever: the log has the same bytes.

    Elsewhere, since they need something else: compiled cores (test_compiled.py), runs that go on from a log
    (test_resume.py), bare runs (test_bare_run.py), plants and units (test_plants.py, test_fmu_runs.py).
    """
    WAYS[way](row, tmp_path, alone)


def test_the_bus_of_a_vehicle_changes_nothing(tmp_path: Path, alone: Alone, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sockets, or zenoh for the agents that got no descriptor."""
    new = Ends.new

    def none_left(ends: Ends, i: int) -> socket.socket:
        if i != 2:
            raise OSError(EMFILE, "Too many open files")
        return new(ends, i)

    monkeypatch.setattr(Ends, "new", none_left)
    assert_same_bytes(once(alone, "rough-sea"), run(tmp_path, "rough-sea"))


@pytest.mark.slow
def test_the_hash_seed_changes_nothing(tmp_path: Path, alone: Alone) -> None:
    """Other processes with other PYTHONHASHSEEDs: no order of a set or of a dict by hash reaches a result.

    Both runs are subprocesses, because a hash seed is fixed when an interpreter starts; the fork server and with it
    every process of the run inherits it.
    """
    logs = []
    for seed in ("1", "2"):
        words = ["--quiet", "--out", tmp_path / seed, "--duration", "3 s", "--set", CHECKS]
        done = fleet("run", "rough-sea", *words, environment={"PYTHONHASHSEED": seed})
        assert (done.returncode, done.stderr) == (0, "")
        logs.append(tmp_path / seed / "latest" / "run.mcap")
    assert_same_bytes(*logs)
    assert_same_bytes(logs[0], once(alone, "rough-sea", "duration=3 s"))


def test_another_seed_gives_another_log(alone: Alone) -> None:
    """The seed does determine the draws: otherwise "the same bytes" would hold for the wrong reason."""
    logs = [once(alone, "rough-sea", "duration=3 s", f"seed={seed}") for seed in (1, 2)]
    assert digest(logs[0]) != digest(logs[1])
    difference = first_difference(*logs)  # a packet, lost in one run and not, or later, in the other
    assert difference.startswith("message ") and "link/" in difference


# --- what the log holds ----------------------------------------------------


@pytest.mark.parametrize(("case", "end_ns"), [("thinned log", 3_000_000_000), ("short last round", 3_070_000_000)])
def test_state_at_the_end_tick_is_logged(case: str, end_ns: int, alone: Alone) -> None:
    """Also when neither the log's rate nor the network's round divides the duration."""
    log = once(alone, case)
    last = {record.topic for record in LogReader(log) if record.log_ns == end_ns}
    expected = {f"uuv/{i}/{group}" for i in (1, 2, 3, 4) for group in ("pose", "state", "error")}
    assert {topic for topic in last if not topic.startswith("link/")} == expected | {"transforms", "scene"}


def test_order_of_the_log(alone: Alone) -> None:
    """One total order, (tick, topic, vehicle or link, sequence): time never goes back, and within a tick topics
    keep the order in which their channels were declared, links the order of (src, dst) and of their packets."""
    reader = LogReader(once(alone, "rough-sea"))
    groups = ["pose", "state", "nav", "command", "guidance", "control", "error"]

    def rank(topic: str) -> tuple[int, ...]:
        match topic.split("/"):
            case ["uuv", i, group]:
                return 0, groups.index(group), int(i)
            case ["transforms" | "scene"]:
                return 0, len(groups) + ["transforms", "scene"].index(topic)
            case ["link", ends]:
                return 1, *map(int, ends.split("-"))
        raise AssertionError(topic)

    keys = [(r.log_ns, *rank(r.topic), r.sequence) for r in reader]
    assert keys == sorted(keys)
    assert len(set(keys)) == len(keys)


def contents(path: Path) -> tuple[bytes, bytes, str, list[int]]:
    """What stands in a log, unpacked: its messages, the raw file with everything else, the texts, the times."""
    messages, rest, texts, times = bytearray(), bytearray(path.read_bytes()), "", []
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            match record:
                case Message():
                    messages += record.data
                    times += [record.log_time, record.publish_time]
                case Attachment():
                    rest += record.data
                    texts += f"{record.name} {record.media_type} {record.data.decode()} "
                    times += [record.log_time, record.create_time]
                case Metadata() | Channel():
                    texts += f"{record.metadata} {getattr(record, 'topic', '')} "
                case Schema():
                    rest += record.data
    return bytes(messages), bytes(rest) + texts.encode(), texts, times


def test_log_says_nothing_of_where_and_when(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No host, user, path, pid, port, run id, credential or wall clock: else no other run could be the same bytes.

    Equality of two runs shows most of this; it cannot show what stays the same on one machine.
    """
    met: dict[str, Any] = {}
    write = RunDirectory.write_connection

    def record(self: RunDirectory, values: dict[str, Any]) -> None:
        met.update(values)
        write(self, values)

    monkeypatch.setattr(RunDirectory, "write_connection", record)
    log = run(tmp_path, "paper")
    messages, rest, texts, times = contents(log)
    assert max(times) == 4_000_000_000
    stamp = log.parent.name.split("-")[2]
    long = [str(tmp_path), met["endpoint"], met["run"], met["password"], stamp]
    assert not [word for word in long if word.encode() in messages + rest]
    # Short words come up by chance among binary numbers, so those are looked for as words of the texts.
    short = [socket.gethostname(), getpass.getuser(), str(met["pid"]), Path(met["endpoint"]).parent.name]
    assert not set(short) & set(re.findall(r"[\w.-]+", texts))


# --- the tool that explains a mismatch -------------------------------------


def test_first_difference_names_the_first_event_that_differs(alone: Alone) -> None:
    """A nudge of one vehicle's start shows as the very first record of that vehicle, both values in clear."""
    a = once(alone, "paper", "duration=1 s")
    b = once(alone, "paper", "duration=1 s", "initial.3.position=8.5 -10.2 0 m")
    text = first_difference(a, b)
    head, names, field, rest = text.splitlines()
    assert head.startswith("message 2: uuv/3/pose, tick 0,")  # poses of vehicles 1 and 2 come before
    assert names.split() == ["field", "a", "b", "|a", "-", "b|", "unit"]
    assert field.split() == ["pose.position.y", "-10.1", "-10.2", "0.1", "m"]
    assert rest == "  (9 other fields the same)"
    with pytest.raises(AssertionError, match="uuv/3/pose, tick 0"):
        assert_same_bytes(a, b)


def test_first_difference_says_when_one_log_ends(tmp_path: Path, alone: Alone) -> None:
    a = once(alone, "paper")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(a.read_bytes()[: a.stat().st_size * 2 // 3])
    assert "b: the log ends here (the file is cut" in first_difference(a, cut)
    assert first_difference(a, a) == ""


def test_decoded_values_are_those_of_the_log(alone: Alone) -> None:
    """The helper decodes with the schema that stands in the file, not with ours."""
    reader = LogReader(once(alone, "paper", "duration=1 s"))
    first = next(iter(reader))
    assert (first.topic, decode(reader, first).frame_id) == ("uuv/1/pose", "ned")
