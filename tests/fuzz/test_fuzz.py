"""Hostile input, wherever the outside can put some: it is refused in words, and no process crashes or hangs over it.

Here are whole processes on a bus that is none, the operator's requests, and files that claim to be logs, scenarios or
live runs. Other tests fuzz single messages (`test_messages`), overrides and damaged scenarios (`test_scenario`,
`test_checks`), link conditions, quantities, studies (`test_strange_studies`), results (`test_strange_files`) and small
files (`test_readers`).

`FUZZ_EXAMPLES=20000 pytest tests/fuzz/test_fuzz.py` looks longer than the suite has time for.
"""

from __future__ import annotations

import json
import os
import random
import struct
from collections.abc import Callable, Sequence
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

import msgpack
import pytest
from any_message import ANY_MESSAGE, messages
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from in_process_runs import Alone, log_of
from live_directory import live_directory
from msgspec.structs import astuple
from nowhere import Nowhere, serve
from tool import invoke as typed

import fleet
from agents.join import serve as serve_agent
from agents.join_file import JoinError, JoinFile
from agents.loop import AgentLoop
from agents.make_agent import make_agent
from agents.payload import StateMessage
from agents.payload import encode as state_payload
from fleet.errors import FleetError, ScenarioError
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.operator import Operator
from fleet.mcap.reader import LogReader
from fleet.mcap.recover import recover
from fleet.recorder.journal import Journal
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from netem.errors import MalformedMessage
from netem.faults import NetFault, fault_values, read_faults
from netem.grammar import parse_condition
from netem.limits import WIRE_MESSAGE
from netem.process import NetemProcess
from netem.realtime_process import RealtimeNetemProcess
from netem.realtime_rounds import RealtimeRounds
from netem.rounds import Rounds
from netem.wire.bus import Bus
from netem.wire.codec import decode, encode
from netem.wire.keys import Keys
from netem.wire.mailbox import Item
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Command,
    Delivery,
    Grant,
    Hello,
    Inbox,
    Nav,
    Note,
    Receipt,
    Round,
    Transmission,
)
from netem.wire.messages import Pace as Begins
from netem.wire.parts import PART_BYTES
from world.lockstep import Lockstep
from world.process import WorldProcess
from world.realtime_process import RealtimeWorldProcess

fuzz = settings(
    max_examples=int(os.environ.get("FUZZ_EXAMPLES", settings.default.max_examples)),
    suppress_health_check=list(HealthCheck),
)
KEYS = Keys("f0220000")

# --- what hostile values look like ------------------------------------------

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.sampled_from([0, -1, 1, 2**31, 2**53, 2**63 - 1, 2**64 - 1, -(2**63)]),
    st.floats(),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e308, 5e-324, -0.0]),
    st.text(max_size=20),
    st.sampled_from(["", "1", "1->2", "*->*", "9" * 5000, "\x00", "\x1b[2J", "ms", "1e400 ms", "10 s", "nan s"]),
    st.binary(max_size=20),
)
ANYTHING = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
)


# Wire bytes that promise more than they hold, or nest deeper than a stack is.
BOMBS = [
    b"\xdd\xff\xff\xff\xff",
    b"\xdf\xff\xff\xff\xff",
    b"\xdb\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xff",
    b"\xc9\xff\xff\xff\xff\x01",
    b"\x91" * 40_000,
    b"\x81\xa1x" * 15_000 + b"\xc0",
    b"\xdd\x7f\xff\xff\xff" * 8_000,
    b"\x94\xa2tx\x00\x00" + b"\xdd\x00\xff\xff\xff",
    b"",
]
WIRE = st.one_of(st.binary(max_size=60), ANYTHING.map(msgpack.packb), st.sampled_from(BOMBS))


# --- processes on a bus that is none ----------------------------------------


def respond_to(answers: list[bytes]) -> Callable[[bytes], None]:
    def respond(data: bytes) -> None:
        assert len(data) <= WIRE_MESSAGE.bytes, "the answer would never arrive"
        answers.append(data)

    return respond


@cache
def paper(*overrides: str) -> Scenario:
    found = load_scenario("paper", ["duration=2 s", "checks={}", *overrides])
    assert (found.vehicles, found.ticks) == (N, END)
    return found


N, END = 4, 200  # vehicles and ticks of all these scenarios
TICKS = st.sampled_from([0, 1, 10, 20, END, 2**63, 2**64 - 1])
# What an agent may put: on its own keys only, but whatever it likes.
COMMANDS = st.builds(
    Command,
    st.sampled_from([0, 0, 0, 1, 2**64 - 1]),
    TICKS,
    st.tuples(*[st.sampled_from([0.0, 1e308, -1e308, 5e-324, 10.0])] * 3),
    st.lists(st.floats(), max_size=40).map(tuple),
)
TRANSMISSIONS = st.builds(
    Transmission,
    st.sampled_from([0, 0, 0, 1]),
    TICKS,
    st.lists(st.binary(max_size=100) | st.just(b"y" * 47_900) | st.just(b""), max_size=4).map(tuple),
)
HELLOS = messages(Hello)
FROM_AGENTS = st.tuples(
    st.integers(1, N) | st.sampled_from([0, 77]),
    st.one_of(WIRE, ANY_MESSAGE.map(encode), (COMMANDS | TRANSMISSIONS | HELLOS | messages(Receipt)).map(encode)),
)


@given(st.lists(FROM_AGENTS, max_size=25), st.sampled_from([1, 10, END]))
@fuzz
def test_no_agent_crashes_the_world(put: list[tuple[int, bytes]], until: int) -> None:
    """Whatever comes on cmd/<i> is taken, or counted and named once; what the world says of it all is well formed."""
    bus = Nowhere()
    world = WorldProcess(bus, KEYS, Lockstep(paper().world_config, frame_every=1))  # type: ignore[arg-type]
    bus.queue.append((KEYS.grant, encode(Grant(until))))
    bus.queue.extend((KEYS.cmd(i), data) for i, data in put)
    serve(world)
    for _, data in bus.put:
        decode(data)
    notes = [decode(data) for key, data in bus.put if key == KEYS.note("world")]
    assert all(isinstance(note, Note) for note in notes)
    assert len(notes) <= 3 * (N + 2)  # of each kind and key the first


@given(st.lists(FROM_AGENTS, max_size=12), st.data())
@fuzz
def test_a_hostile_agent_does_not_disturb_the_rest(put: list[tuple[int, bytes]], data: st.DataObject) -> None:
    """Every agent answers every nav; agent 1 says anything besides. The others' vehicles move as if it had not."""
    honest = run_world({})
    assert len(honest) == 5 * (N - 1)
    between = {data.draw(st.integers(0, 12)): wire for _, wire in put}
    assert run_world(between) == honest


def run_world(between: dict[int, bytes]) -> list[bytes]:
    """What the agents 2 to 4 are told when each nav is answered with a constant command for five ticks."""
    bus = Nowhere()
    world = WorldProcess(bus, KEYS, Lockstep(paper().world_config, frame_every=1))  # type: ignore[arg-type]
    bus.queue.append((KEYS.grant, encode(Grant(5))))
    serve(world)
    told, seen = [], 0
    for step in range(40):
        if seen == len(bus.put):
            break
        fresh, seen = bus.put[seen:], len(bus.put)
        if step in between:
            bus.queue.append((KEYS.cmd(1), between[step]))
        for key, wire in fresh:
            i = key.rsplit("/", 1)[-1]
            message = decode(wire)
            if not isinstance(message, Nav):
                continue
            if i != "1":
                told.append(key.encode() + wire)
            size = paper().world_config.vehicles[int(i) - 1].telemetry_size or 0
            answer = Command(message.incarnation, message.tick, (20.0, 0.5, -0.5), (0.0,) * size)
            bus.queue.append((KEYS.cmd(i), encode(answer)))
        serve(world)
    return sorted(told)


CHANGING = "network.links={'*': {states: {a: {mean: 20 ms}, b: {condition: loss 50% rate 1kbit, mean: 20 ms}}}, 1->2: "
CHANGING += '{trace: "delivered,delay [ms]\\n1,30\\n0,\\n", by: packet}}'


@given(st.lists(st.tuples(FROM_AGENTS, st.booleans()), max_size=25), st.sampled_from([(), (CHANGING,)]))
@fuzz
def test_no_agent_crashes_netem(put: list[tuple[tuple[int, bytes], bool]], network_of: tuple[str, ...]) -> None:
    """Whatever comes on tx/<i>, rounds go on among them: taken or refused, and everything that goes out fits."""
    config = paper(*network_of).netem_config
    bus = Nowhere()
    network = NetemProcess(bus, KEYS, config, Rounds(config))  # type: ignore[arg-type]
    items = [(KEYS.tx(i), data) for (i, data), _ in put]
    tick = 0
    for number, (_, round_follows) in enumerate(put):
        if round_follows:
            alive = tuple(range(1, N + 1))
            said = Round(tick, alive, tuple((0.0, 0.0, float(i)) for i in alive), ())
            items.insert(number, (KEYS.round, encode(said)))
            state = state_payload(StateMessage(1, tick, (0.0,) * 3, (0.0,) * 3))
            items += [(KEYS.tx(i), encode(Transmission(0, tick, (state,)))) for i in alive]
            tick += paper().round_ticks
    bus.queue.extend(items)
    serve(network)
    for _, data in bus.put:
        decode(data)


@given(st.lists(st.tuples(FROM_AGENTS, st.sampled_from(["world", "netem"])), max_size=25))
@fuzz
def test_no_agent_crashes_a_run_on_a_wall_clock(put: list[tuple[tuple[int, bytes], str]]) -> None:
    """The same for the processes that wait for nobody, while ticks come and go."""
    bus, config = Nowhere(), paper().world_config
    world = RealtimeWorldProcess(bus, KEYS, config, 1, 1.0)  # type: ignore[arg-type]
    rounds = RealtimeRounds(paper().netem_config)
    network = RealtimeNetemProcess(bus, KEYS, paper().netem_config, rounds)  # type: ignore[arg-type]
    world._handle(KEYS.grant, encode(Grant(paper().ticks)))
    network._handle(Item(KEYS.round, encode(Begins(0, 0, config.tick_ns)), None))
    for (i, data), to in put:
        if to == "world":
            world._publish(world._realtime.begin())
            world._handle(KEYS.cmd(i), data)
            world._publish(world._realtime.finish())
        else:
            network._handle(Item(KEYS.tx(i), data, None))
    for _, data in bus.put:
        decode(data)


@pytest.mark.parametrize("size", [30_000, 47_980])
def test_a_huge_payload_is_no_end_of_netem(size: int) -> None:
    """With its header, a payload that an agent could just send no longer fits into an inbox: refused, not forwarded."""
    bus = Nowhere()
    network = NetemProcess(bus, KEYS, paper().netem_config, Rounds(paper().netem_config))  # type: ignore[arg-type]
    everybody = tuple(range(1, N + 1))
    for tick in range(0, 5 * paper().round_ticks, paper().round_ticks):
        said = Round(tick, everybody, tuple((0.0, 0.0, float(i)) for i in everybody), ())
        bus.queue.append((KEYS.round, encode(said)))
        for i in everybody:
            wire = encode(Transmission(0, tick, (b"y" * (size if i == 1 else 63),)))
            bus.queue.append((KEYS.tx(i), wire))
    serve(network)
    notes = [decode(data) for key, data in bus.put if key == KEYS.note("netem")]
    heard = [key for key, _ in bus.put if key == KEYS.rx(2)]
    if size > PART_BYTES:
        assert notes[0].text == (  # type: ignore[union-attr]
            f"rejected on {KEYS.tx(1)}: malformed tx message: "
            f"a payload of {size} bytes; at most {PART_BYTES} are carried"
        )
        assert not heard  # nobody's round is complete, and the console says for whom it waits
    else:
        assert len(heard) >= 5
        assert not notes


# Payloads that are well formed, and enormous or absurd in what they say.
REALS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([1e308, -1e308, 1.7e308, 1e155, 1e200, 5e-324, 0.0]),
    st.floats(-1e6, 1e6),
)
LIES = st.builds(
    StateMessage,
    st.integers(0, N),
    st.sampled_from([0, 1, 5, 10, 2**63]),
    st.tuples(*[REALS] * 3),
    st.tuples(*[REALS] * 3),
).map(state_payload)


@given(
    st.sampled_from(["boc", "bsmc", "nbc", "nboc"]),
    st.lists(st.tuples(st.integers(0, 12), LIES | st.binary(max_size=80)), max_size=8),
)
@fuzz
def test_no_neighbour_crashes_an_agent(controller: str, heard: list[tuple[int, bytes]]) -> None:
    """An agent answers every nav with a finite command, whatever its neighbours say of themselves."""
    scenario = paper(f"controller={controller}", "network.payload=full")
    config = scenario.agent_config(2)
    loop = AgentLoop(make_agent(config), config.round_ticks, incarnation=0, begin=0)
    m, ticks = config.round_ticks, 25
    sender = scenario.agent_config(2).neighbours[0].id
    eta, nu = scenario.initial[1]
    answers = []
    for tick in range(ticks):
        if tick % m == 0:
            due = [
                Delivery(max(1, when + tick), tick, sender, number, 0, payload)
                for number, (when, payload) in enumerate(heard)
            ]
            kept = tuple(sorted((d for d in due if tick < d.due_tick <= tick + m), key=astuple))
            answers += loop.inbox(Inbox(0, tick + m, False, kept))
        answers += loop.nav(Nav(0, tick, eta, nu))
    commands = [answer for answer in answers if isinstance(answer, Command)]
    assert len(commands) == ticks
    assert all(isfinite(x) for command in commands for x in command.tau)


REQUESTS = st.one_of(
    WIRE,
    st.fixed_dictionaries(
        {"op": st.sampled_from(["ready", "waiting", "ticks", "faults", "absences", "close"]) | ANYTHING},
        optional=dict.fromkeys(("faults", "absences", "tick"), ANYTHING),
    ).map(msgpack.packb),
    st.fixed_dictionaries(
        {
            "op": st.just("faults"),
            "faults": st.lists(
                st.tuples(
                    ANYTHING, ANYTHING, ANYTHING, st.sampled_from(["link", "mute", "slow", "down"]) | ANYTHING,
                    ANYTHING, ANYTHING, ANYTHING, ANYTHING,
                ).map(list),
                max_size=2,
            ),
        }
    ).map(msgpack.packb),
    st.fixed_dictionaries(
        {"op": st.just("absences"), "absences": st.lists(st.tuples(ANYTHING, ANYTHING, ANYTHING).map(list))}
    ).map(msgpack.packb),
)  # fmt: skip


@given(st.lists(REQUESTS, max_size=6))
@fuzz
def test_control_requests_are_answered(requests: list[bytes]) -> None:
    """World and netem answer whatever is asked on ctl/*."""
    bus = Nowhere()
    WorldProcess(bus, KEYS, Lockstep(paper().world_config, frame_every=1))  # type: ignore[arg-type]
    NetemProcess(bus, KEYS, paper().netem_config, Rounds(paper().netem_config))  # type: ignore[arg-type]
    answers: list[bytes] = []
    for wire in requests:
        for role in ("world", "netem"):
            bus.answers[KEYS.ctl(role)](KEYS.ctl(role), wire, respond_to(answers))
    assert len(answers) == 2 * len(requests)
    assert all(isinstance(msgpack.unpackb(answer), dict) for answer in answers)


@pytest.mark.parametrize(
    "text", ["delay 60ms 20ms loss gemodel 10% 40%", "loss state 1% 30%", "down", "rate 10kbit limit 3"]
)
def test_faults_that_are_meant_are_taken(text: str) -> None:
    """What the console sends of a fault is taken as it was; with one value of another type it is refused."""
    fault = NetFault("live-1", 3, None, "link", ((1, 2), (2, 1)), (), parse_condition(text))
    wire = msgpack.unpackb(msgpack.packb([fault_values(fault)]))
    assert read_faults(wire) == (fault,)
    for key in wire[0][6]:
        for stranger in ("x", []):
            spoilt = [*wire[0][:6], wire[0][6] | {key: stranger}, 0]
            with pytest.raises(MalformedMessage):
                read_faults([spoilt])


# --- the operator ------------------------------------------------------------

FAULTS = ["link", "down", "up", "partition", "kill", "mute", "deaf", "slow", "pause", "noise", "bias", "freeze",
          "dropout", "dvl", "compass", "fix", "efficiency", "saturate", "off", "stuck", "current", "gust",
          "wrench", "clock"]  # fmt: skip
PLAUSIBLE = st.one_of(
    ANYTHING,
    st.sampled_from(
        [
            3, [1, 2], "halves", "isolate:3", "1,2 / 3,4", "1 / 1", "isolate:99", "ring", "majority",
            {"1->2": "loss 20%"}, {"*->*": "delay 1e9s"}, {"1<->2": "loss 5%"}, {"9->9": "down"}, "1->2", ["1->2"],
            {"vehicles": 2, "by": "5 ticks"}, {"vehicles": 1, "position_noise": "10 cm"}, {"probability": "30 %"},
            {"velocity": "0 0.5 0 m/s", "over": "10s"}, {"velocity": "1e308 0 0 m/s", "over": "0 s"},
            {"vehicles": 2, "step": "-1 s", "drift": "1e5 ppm"}, {"step": "25 h"}, {"drift": "-2 ppb"},
            {"mean": "0.2 0 0 m/s", "sigma": "5 5 0 cm/s", "time_constant": "20s"}, {"vehicles": [0]},
            {"lost": "30 %", "jump": "1 m", "chance": "20 %"}, {"bias": "1e308 0 0 m/s"}, {"bias": "1e308 deg"},
        ]
    ),
)  # fmt: skip
ENTRIES = st.dictionaries(
    st.sampled_from([*FAULTS, "for", "id", "seed"]), PLAUSIBLE | st.sampled_from(["1 s", "10 ms", "9e9 s"]), max_size=3
)
OPERATIONS = st.one_of(
    st.fixed_dictionaries({"op": st.just("inject"), "fault": ENTRIES | ANYTHING}),
    st.fixed_dictionaries({"op": st.just("heal")}, optional={"id": ANYTHING | st.just("live-1")}),
    st.fixed_dictionaries(
        {"op": st.just("clock"), "do": st.sampled_from(["pause", "resume", "step", "speed"]) | ANYTHING},
        optional={"value": ANYTHING | st.sampled_from([1, 10, 2**64 - 1, 0.5, 1e-300, 1e6])},
    ),
    st.fixed_dictionaries({"op": st.sampled_from(["status", "faults"]) | ANYTHING}),
    st.dictionaries(st.text(max_size=5), ANYTHING, max_size=3),
)


class Silent:
    """A log that keeps nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: None


@given(st.lists(OPERATIONS, max_size=10))
@fuzz
def test_every_operation_is_answered(asked: list[dict[str, Any]]) -> None:
    """The console answers whatever holders of the operator's credentials ask, and goes on granting."""
    operator = an_operator()
    for number, request in enumerate(asked):
        answer = msgpack.packb(operator.handle(request))
        assert len(answer) <= WIRE_MESSAGE.bytes, "the answer would never arrive"
        # As the console does in its loop: the clock must go on being a number of ticks.
        until = operator.clock.until(number, float(number))
        assert 0 <= until <= paper().ticks
        encode(Grant(until))


def an_operator(granted: int = 3) -> Operator:
    clock = LiveClock(GrantPolicy(paper().ticks, paper().tick_ns, paper().round_ticks, 1, None), 0.0)
    journal = Journal(paper(), Silent())  # type: ignore[arg-type]
    return Operator(paper(), journal, clock, Obedient(granted))


class Obedient:
    """A fleet that does whatever its operator asks for."""

    begun, waiting = True, ""

    def __init__(self, granted: int) -> None:
        self.granted = granted

    def ask(self, role: str, op: str, **fields: Any) -> dict[str, Any]:
        return {}

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        return True

    def vehicles_without_agent(self) -> list[int]:
        return []

    def _done(self, *_: Any) -> None:
        pass

    set_world_faults = set_absences = announce = start_agent = end_agents = restart_agent = _done


# --- files -------------------------------------------------------------------


@pytest.fixture(scope="module")
def log(made: Alone) -> Path:
    """A short run's log: chunks, attachments, metadata, an index."""
    return log_of(made("paper", "duration=300 ms", "checks={}"))


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The same with a few wounds: bits, lengths, holes, repetitions, strangers, an early end."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if not out:
            break
        at = rng.randrange(len(out))
        match rng.randrange(7):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                number = rng.choice([0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1, rng.randrange(10**6)])
                out[at : at + 8] = struct.pack("<Q", number)
            case 2:
                out[at : at + 4] = struct.pack("<I", rng.choice([0, 1, 2**31, 2**32 - 1, rng.randrange(10**4)]))
            case 3:
                del out[at : at + rng.randrange(1, 400)]
            case 4:
                out[at:at] = out[at : at + rng.randrange(1, 400)]
            case 5:
                out[at:at] = rng.randbytes(rng.randrange(1, 40))
            case _:
                del out[at:]
    return bytes(out)


@given(st.integers(0, 2**63))
@fuzz
def test_no_log_crashes_its_readers(log: Path, tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """A file that claims to be a log is read as far as it is one, recovered or refused; the same by every reader."""
    folder = tmp_path_factory.getbasetemp()
    path, mended = folder / "fuzzed.mcap", folder / "mended.mcap"
    path.write_bytes(damaged(log.read_bytes(), random.Random(seed)))
    mended.unlink(missing_ok=True)
    total = 0
    try:
        reader = LogReader(path)
        total = sum(1 for _ in reader)
        assert reader.missing or total
    except FleetError as error:
        assert str(error)  # noqa: PT017
    try:
        recover(path, mended)
    except FleetError as error:
        assert str(error)  # noqa: PT017
    else:
        assert total == 0 or sum(1 for _ in LogReader(mended)) >= total
    try:
        opened = fleet.open_log(path)
        for name in list(opened.topics):
            opened[name]
    except (FleetError, UserWarning) as error:
        assert str(error)  # noqa: PT017


HOSTILE_YAML = [
    "[", "{", "}", ": :", "- - - -", "&a [*a, *a]", "*a", "!!python/object/apply:os.system [id]", "!!binary aGk=",
    "? [a]: b", "9" * 400, "1e309", "-1e309", ".nan", ".inf", "-.inf", "0x7fffffff", "12:30:00", "yes",
    "~", "'", '"\\x00"', '"\\ud800"', "|", ">", "%", "@x", "`x", "\t", "---", "...", "<<: *a", "-1 s", "1 furlong",
    "0", "-1", "1e-320", "100000", "[]", "{}", "[[[]]]", "null", "true", "{1->2: {}}", "halves", "1->2", "*->*",
    "[" * 40 + "]" * 40, "{a: " * 40 + "1" + "}" * 40, "x" * 5000, "\u2028", "\x85", "\ufeff", "ms", "1 ms 2 ms",
]  # fmt: skip


def worn(text: str, rng: random.Random) -> str:
    """A scenario's text with a few changes that hands, editors and enemies make."""
    lines = text.splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(lines))
        line, hostile = lines[at], rng.choice(HOSTILE_YAML)
        key, colon, value = line.partition(": ")
        match rng.randrange(8):
            case 0:
                lines[at] = f"{key}: {hostile}"
            case 1:
                lines[at] = hostile
            case 2:
                del lines[at]
            case 3:
                lines.insert(rng.randrange(len(lines) + 1), line)
            case 4:
                lines[at] = " " * rng.randrange(9) + line.strip()
            case 5:
                place = rng.randrange(len(line) + 1)
                lines[at] = line[:place] + hostile + line[place:]
            case 6:
                lines[at] = f"{key}{colon}{rng.choice(lines).partition(': ')[2]}"
            case _:
                digits = [n for n, c in enumerate(value) if c.isdigit()]
                if digits:
                    place = rng.choice(digits)
                    value = value[:place] + rng.choice(["-", "0", "9" * 12, "e9", ".", "1e-9"]) + value[place + 1 :]
                lines[at] = key + colon + value
        if not lines:
            break
    return "\n".join(lines)


@given(st.sampled_from(sorted(shipped_scenarios())), st.integers(0, 2**63))
@fuzz
def test_no_scenario_text_crashes_the_loader(name: str, seed: int) -> None:
    """A worn scenario is a scenario still, or every mistake of it is told; nothing else is raised."""
    try:
        scenario = parse_scenario(
            worn(load_scenario(name).to_yaml(), random.Random(seed)), "worn.yaml", policy=Policy()
        )
    except ScenarioError as error:
        assert str(error)  # noqa: PT017
    else:
        for i in range(1, min(scenario.vehicles, 3) + 1):
            msgpack.packb(scenario.agent_config(i).to_values())
        assert scenario.world_config and scenario.netem_config


CONNECTIONS = st.one_of(
    ANYTHING.map(lambda value: json.dumps(value, default=str)),
    st.text(max_size=60),
    st.fixed_dictionaries(
        {
            "endpoint": st.sampled_from(["tcp/127.0.0.1:1", "tcp/[::1]:1", "no/x", "", "tcp/", "udp/::1:1"]) | SCALARS,
            "run": st.sampled_from(["0123abcd", "", "*", "a/**", "#", "a//b", "$*"]) | SCALARS,
            "scenario": st.just("paper") | SCALARS,
            "pid": st.sampled_from([os.getpid(), 0, -1, 2**80, 2**31, "1", 1e300, float("nan")]) | SCALARS,
            "user": st.just("operator") | SCALARS,
            "password": st.just("x") | SCALARS,
        },
        optional={"more": ANYTHING},
    ).map(lambda values: json.dumps(values, default=str)),
    st.sampled_from(["[" * 3_000, "9" * 5_000, '{"pid": ' + "9" * 5000 + "}", "\udcff"]),
)  # fmt: skip


@given(CONNECTIONS)
@fuzz
def test_no_connection_file_crashes_the_tools(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """`fleet ls` and `fleet status` say in a line what they make of any connection.json, without a traceback."""
    with pytest.MonkeyPatch.context() as patch, live_directory(tmp_path_factory.getbasetemp() / "fuzzed-runs") as run:
        connect = Bus.connect
        patch.setattr(Bus, "connect", lambda *given, **_: connect(*given, timeout_ms=50))  # nobody will ever answer
        (run / "connection.json").write_bytes(text.encode("utf-8", "surrogateescape"))
        for arguments in (["ls"], ["ls", "--json"], ["status"], ["status", "--run", str(run)]):
            result = typed(*arguments)
            assert result.exit_code in (0, 3), (result.exit_code, result.output)
            assert "Traceback" not in result.output


JOIN_FILES = st.one_of(
    st.fixed_dictionaries(
        {
            "version": st.just(PROTOCOL_VERSION) | SCALARS,
            "endpoint": st.sampled_from(["tcp/127.0.0.1:1", "tcp/127.0.0.1:99999", "tcp/[::1]:1"]) | st.integers(),
            "run": st.sampled_from(["0123abcd", "*", "a//b", ""]) | SCALARS,
            "vehicle": st.sampled_from([3, 0, -1, 2**70]) | SCALARS,
            "user": st.just("agent-3") | SCALARS,
            "password": st.just("x") | SCALARS,
        },
        optional=dict.fromkeys(("ca", "certificate", "lease_ms", "incarnation", "begin", "scenario"), SCALARS),
    ).map(lambda values: json.dumps(values, default=str)),
    ANYTHING.map(lambda value: json.dumps(value, default=str)),
    st.sampled_from(["[" * 3_000, "9" * 5_000, "", "\udcff"]),
)


@given(JOIN_FILES)
@fuzz
def test_no_join_file_crashes_an_agent(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """Any file that is none is refused in words, and so is one that leads nowhere."""
    path = tmp_path_factory.getbasetemp() / "join-fuzzed.json"
    path.touch(0o600)
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(JoinError) as caught:
        serve_agent(JoinFile.read(path), lambda _: None)
    assert 0 < len(str(caught.value)) < 1000
