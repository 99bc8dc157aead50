"""The world process on a bus that is none: whom it asks, and when its frames leave."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest
from nowhere import Nowhere, serve

from fleet.scenario.loading import load_scenario
from netem.fault_kinds import WorldFaultKind
from netem.wire.codec import decode, encode
from netem.wire.keys import Keys
from netem.wire.messages import Command, Frames, Grant, Nav, Note, Round, WorldFault, WorldFaults
from world import process
from world.lockstep import Lockstep
from world.process import WorldProcess

SCENARIO = load_scenario("paper", ["duration=300 ms", "checks={}"])
KEYS = Keys("f0220000")
SIZE = SCENARIO.layout(1).size


class Fleet:
    """A world, and agents that answer when they are told to."""

    def __init__(self, most_asked: int | None = None) -> None:
        self.bus = Nowhere()
        run = Lockstep(SCENARIO.world_config)
        self.world = WorldProcess(self.bus, KEYS, run, most_asked=most_asked)  # type: ignore[arg-type]
        self.asked: dict[int, Nav] = {}
        self.said: list[Frames | Round | Note] = []

    def put(self, key: str, message: Command | Grant | WorldFaults) -> None:
        """Give the world a message, and take what it says."""
        self.put_bytes(key, encode(message))

    def put_bytes(self, key: str, data: bytes) -> None:
        """The same with bytes that may be no message."""
        self.bus.queue.append((key, data))
        serve(self.world)
        for where, data in self.bus.put:
            message = decode(data)
            if isinstance(message, Nav):
                self.asked[int(where.rsplit("/", 1)[1])] = message
            elif isinstance(message, (Frames, Round, Note)):
                self.said.append(message)
        self.bus.put.clear()

    def answer(self, i: int) -> None:
        nav = self.asked.pop(i)
        self.put(KEYS.cmd(i), Command(0, nav.tick, (1.0, 0.1, -0.1), (0.0,) * SIZE))


def test_frames_leave_with_their_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message for each would wake the console at every tick; those of the last ticks leave when nobody is asked."""
    monkeypatch.setattr(process, "monotonic", lambda: 0.0)
    fleet = Fleet()
    fleet.put(KEYS.grant, Grant(25))
    while fleet.asked:
        fleet.answer(min(fleet.asked, key=lambda i: (fleet.asked[i].tick, i)))
    messages = [[frame.tick for frame in said.frames] for said in fleet.said if isinstance(said, Frames)]
    assert messages == [[0], [*range(1, 11)], [*range(11, 21)], [*range(21, 25)]]


def test_frames_of_slow_agents_do_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter(range(1000))
    monkeypatch.setattr(process, "monotonic", lambda: float(next(now)))
    fleet = Fleet()
    fleet.put(KEYS.grant, Grant(5))
    while fleet.asked:
        fleet.answer(min(fleet.asked, key=lambda i: (fleet.asked[i].tick, i)))
    messages = [[frame.tick for frame in said.frames] for said in fleet.said if isinstance(said, Frames)]
    assert messages == [[tick] for tick in range(5)]


def test_who_was_not_asked_cannot_answer() -> None:
    """Not even the nav that waits for its agent's turn: it would leave when it was answered already."""
    fleet = Fleet(most_asked=1)
    fleet.put(KEYS.grant, Grant(25))
    assert list(fleet.asked) == [1]
    fleet.put(KEYS.cmd(2), Command(0, 0, (1.0, 0.1, -0.1), (0.0,) * SIZE))
    (note,) = fleet.said
    assert isinstance(note, Note)
    assert "no nav is unanswered" in note.text
    turns = []
    while fleet.asked:
        (i,) = fleet.asked
        turns.append((i, fleet.asked[i].tick))
        fleet.answer(i)
    assert turns[:6] == [(1, 0), (2, 0), (3, 0), (4, 0), (1, 1), (1, 2)]
    assert sorted(turns) == [(i, tick) for i in (1, 2, 3, 4) for tick in range(25)]


def test_who_has_not_been_asked_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what is held back for the end of the round leaves when the console asks why nothing moves."""
    monkeypatch.setattr(process, "monotonic", lambda: 0.0)
    fleet = Fleet(most_asked=1)
    fleet.put(KEYS.grant, Grant(25))
    for _ in range(4):  # the round tick 0, one after the other
        fleet.answer(min(fleet.asked))
    for _ in range(3):
        fleet.answer(min(fleet.asked))
    (asked,) = fleet.asked
    answers: list[bytes] = []
    fleet.bus.answers[KEYS.ctl("world")](KEYS.ctl("world"), msgpack.packb({"op": "waiting"}), answers.append)
    assert [i for i, _ in msgpack.unpackb(answers[0])["waiting"]] == [asked]
    assert fleet.world._frames == []


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (["f", 5, None, "leak", [], []], "faults[0][3]: Invalid enum value 'leak'"),
        (["f", -5, None, "off", [], []], "faults[0][1]: expected an unsigned integer"),
        (["f", 5, None, "off", []], "faults[0]: Expected `array` of at least length 6, got 5"),
        (["f", 5, None, "gust", [], [1.0]], "'f': gust has 4 values, not 1"),
        (b"\x90", "faults[0]: Expected `array`, got `bytes`"),
    ],
)
def test_malformed_faults_are_refused_and_those_before_stay(fault: Any, said: str) -> None:
    fleet = Fleet()
    fleet.put(KEYS.grant, WorldFaults((WorldFault("before", 0, None, WorldFaultKind.OFF, (), ()),)))
    fleet.put_bytes(KEYS.grant, msgpack.packb(["faults", [fault]]))
    (note,) = fleet.said
    assert isinstance(note, Note)
    assert note.text == f"rejected on {KEYS.grant}: malformed faults message: {said}"
    assert [fault.id for fault in fleet.world._state.world.faults] == ["before"]
