"""The same seed gives the same bytes: whatever runs it, in whatever order it starts, wherever and whenever."""

from __future__ import annotations

import getpass
import re
import socket
from collections.abc import Callable
from errno import EMFILE
from pathlib import Path
from typing import Any

import pytest
from first_difference import assert_same_bytes, decode, first_difference
from in_process_runs import Alone, log_of, recorded
from marks import slow
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from spawned import fleet

from fleet.execution.directory import RunDirectory
from fleet.logs.reader import LogReader, digest
from fleet.result.result import Status
from netem.wire.vehicle_bus import Ends

CHECKS = "checks={qp_infeasible: {at_most: 0}, ledger: balanced, middleware_loss: {at_most: 0}}"
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

CLOCKS = "agent.clock={drift: {sigma: 2000 ppm}, offset: {mean: 5 ms, sigma: 30 ms}}"
CLOCK_FAULTS = (
    "faults=[{at: 1 s, for: 1 s, clock: {vehicles: 2, step: -200 ms, drift: 1e4 ppm}}, {at: 1.5 s, clock: {step: 1 s}}]"
)
HELD = "faults=[{at: 1 s, for: 1 s, hold: 1->2}, {at: 2 s, for: 1 s, duplicate: {links: 2->3, after: 500 ms}}]"
TRIGGER = "triggers=[{when: {topic: control.leads, above: 0}, for: 1 s, fault: {pause: itself}}]"
SLOTS = "network.acoustic={modem: s2c, mac: tdma, slot: 1.4 s, guard: 1.05 s}"

# What each adds: nothing; loss, jitter and the disturbance; draws in the world process; frames that are not sent
# every tick, and an end tick between two of them; a last round that is cut; the tightest coupling there is; estimates
# in place of the truth; a graph in which vehicles hear more than one other, and numbers of two digits; links that
# change by themselves; a QP at every tick; clocks that are drawn, drift, and are set, of agents, modems and protocols;
# vehicles that do not move, packets that are held or come twice, and a fault that an agent's report begins.
CASES: dict[str, tuple[str, list[str]]] = {
    "paper": ("paper", ["duration=4 s"]),
    "rough-sea": ("rough-sea", ["duration=6 s"]),
    "sensor noise": ("paper", ["duration=3 s", *NOISE]),
    "thinned log": ("rough-sea", ["duration=3 s", "log.every=7 ticks", "log.pose=21 ticks"]),
    "short last round": ("paper", ["duration=3.07 s", ROUGH]),
    "a round per tick": ("paper", ["duration=2 s", "network.period=10 ms", ROUGH]),
    "states and a trace": ("paper", ["duration=3 s", CHANGING]),
    "kept apart": ("crossing", ["duration=3 s", "keep_apart.distance=25 m", "checks={tumbled: waived}"]),
    "dead reckoning": ("dead-reckoning", ["duration=3 s", INSTRUMENTS, "log.every=3 ticks"]),
    "clocks": ("rough-sea", ["duration=3 s", CLOCKS, CLOCK_FAULTS]),
    "clocks and slots": ("acoustic-s2c", ["duration=6 s", SLOTS, CLOCKS, CLOCK_FAULTS, "checks={tumbled: waived}"]),
    "clocks of a protocol": ("election", ["duration=3 s", CLOCKS, CLOCK_FAULTS]),
    "held and triggered": ("election", ["duration=5 s", "moored=true", HELD, TRIGGER]),
    "twelve in a ring": ("paper", ["vehicles=12", "graph.shape=ring", "duration=2 s", *NOISE, ROUGH]),
}

# The world hosts the router, so those before it in the second order knock at a door that is not there yet.
ORDERS: dict[str, Callable[[list[str]], list[str]]] = {
    "as listed": lambda roles: roles,
    "world last": lambda roles: roles[::-1],
    "agents first": lambda roles: sorted(roles),
}


def marked(*quick: str) -> list[Any]:
    """All cases, those that are not named as slow ones: each adds something, and the first of them show the law."""
    return [pytest.param(case, marks=[] if case in quick else [pytest.mark.slow]) for case in CASES]


def run(out: Path, case: str, *more: str, **options: Any) -> Path:
    """The log of one run of a case."""
    scenario, overrides = CASES[case]
    result = recorded(out, scenario, CHECKS, *overrides, *more, **({"in_process": False} | options))
    assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
    return result.directory / "run.mcap"


def once(alone: Alone, case: str, *more: str) -> Path:
    """The log of a case in this process, made once."""
    scenario, overrides = CASES[case]
    return log_of(alone(scenario, CHECKS, *overrides, *more))


@pytest.mark.parametrize("case", marked("rough-sea", "clocks of a protocol"))
def test_same_seed_same_bytes(case: str, tmp_path: Path, alone: Alone) -> None:
    """Two runs in one process: nothing is left over from the first, or from one between them, that the second sees."""
    assert_same_bytes(once(alone, case), run(tmp_path, case, in_process=True))


@pytest.mark.parametrize("order", ["world last", *slow("agents first")])
@pytest.mark.parametrize("case", marked("rough-sea", "thinned log", "dead reckoning", "clocks and slots", "kept apart"))
def test_distributed_is_in_process(case: str, order: str, tmp_path: Path, alone: Alone) -> None:
    """Processes over zenoh and a plain loop write the same file, so no scheduling, no order of arrival and no
    start order reaches a result. Every distributed run schedules differently, so each is a new sample of that."""
    assert_same_bytes(once(alone, case), run(tmp_path, case, start_order=ORDERS[order]))


def test_the_bus_of_a_vehicle_changes_nothing(tmp_path: Path, alone: Alone, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sockets, or zenoh for the agents that got no descriptor."""
    new = Ends.new

    def none_left(ends: Ends, i: int) -> socket.socket:
        if i != 2:
            raise OSError(EMFILE, "Too many open files")
        return new(ends, i)

    monkeypatch.setattr(Ends, "new", none_left)
    assert_same_bytes(once(alone, "rough-sea"), run(tmp_path, "rough-sea"))


def test_the_formula_gives_the_gains_that_piqp_confirms(alone: Alone) -> None:
    """All messages are the same; the scenario that the log holds differs."""
    assert digest(once(alone, "rough-sea")) == digest(once(alone, "rough-sea", "guidance.solver=exact"))


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


def test_speed_changes_nothing(tmp_path: Path, alone: Alone) -> None:
    """Grants paced by the wall clock come in other portions than grants ahead of it; neither is a result."""
    fast = once(alone, "thinned log")
    assert_same_bytes(fast, run(tmp_path, "thinned log", in_process=True, speed=6.0))
    assert_same_bytes(fast, run(tmp_path, "thinned log", speed=4.0))


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
