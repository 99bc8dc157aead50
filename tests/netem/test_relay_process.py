"""The process of the relay with robots that are no sessions: who is slow delays nobody else, and every token counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from multiprocessing import Pipe
from queue import SimpleQueue
from threading import Event, Thread
from time import monotonic_ns
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_for

from netem import relay_process
from netem.cause import Cause
from netem.config import NetemConfig
from netem.faults import NetFault, fault_values
from netem.limits import RELAY_WAITING, ROBOT_WAITING
from netem.relay import MessageFate
from netem.relay_messages import Port, RelayReport, Setup, Watched, WatchedMessage
from netem.relay_process import RelayProcess
from netem.robot_message import DATAGRAM, PUT, RobotMessage
from netem.wire import robot_queues
from netem.wire.robot_queues import Inlet, Outlet
from netem.wire.robots import RobotEndpoint, Token, Unfit

LIMIT_S = 60.0
NAMES = ("talker", "slow", "fast")
SIZE = 1 << 20


class Robot:
    """Keeps what is handed to it, and shows tokens. One that is called slow takes nothing until `goes` is set."""

    goes = Event()

    def __init__(self, access: RobotEndpoint, carry: tuple[str, ...], inlet: Inlet) -> None:
        self.port = None
        self.number, self.name, self.outlet = access.number, access.name, Outlet()
        self.stayed: Counter[str] = Counter()
        self.matched = {0}
        self.routers: list[str] = []
        self.placed: list[tuple[str, bytes]] = []
        self.taken: list[RobotMessage] = []
        self.shown: set[str] = set()

    def begin(self) -> None:
        pass

    def close(self) -> None:
        self.outlet.close()

    def carries(self, token: str) -> bool:
        return True

    def mirror(self, token: str) -> None:
        self.shown.add(token)

    def withdraw(self, token: str) -> None:
        self.shown.discard(token)

    def hand(self, message: RobotMessage, payload: bytes) -> None:
        if self.name == "slow":
            self.goes.wait(LIMIT_S)
        self.taken.append(message)


class Served:
    """A process that serves on a thread, and what it tells the console."""

    def __init__(
        self, links: list[tuple[int, int]], ports: tuple[Port, ...] = (), *, begins: bool = True, **setup: Any
    ) -> None:
        """`begins`: the run begins now, and not when the console says so."""
        numbers = (1, 2, 3)
        config = NetemConfig(
            seed=1, tick_ns=1_000_000, round_ticks=100, vehicles=numbers, links=tuple(links), conditions={}
        )
        meetings = tuple(RobotEndpoint(i, NAMES[i - 1], listen="tcp/none") for i in numbers)
        self.console, theirs = Pipe()
        self.queue: SimpleQueue[Any] = SimpleQueue()
        self.process = RelayProcess(theirs, Setup(config, meetings, ("**",), ports, **setup), self.queue)
        self.robots: Any = self.process._robots
        self.thread = Thread(target=self.process.serve, args=(monotonic_ns() if begins else None,), daemon=True)
        self.thread.start()

    def tell(self, **request: Any) -> None:
        self.console.send_bytes(msgspec.msgpack.encode(request))

    def end(self) -> tuple[list[MessageFate], RelayReport]:
        """All fates, and the last report with the notes of all."""
        self.tell(op="close")
        return self.rest()

    def rest(self) -> tuple[list[MessageFate], RelayReport]:
        fates: list[MessageFate] = []
        notes: list[str] = []
        self.watched: list[WatchedMessage] = []
        while True:
            report = msgspec.msgpack.decode(self.console.recv_bytes(), type=RelayReport)
            fates += report.fates
            notes += report.notes
            self.watched += report.watched
            if report.closing is not None:
                report.notes = notes
                return fates, report


@pytest.fixture(autouse=True)
def robots(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(relay_process, "Robot", Robot)
    monkeypatch.setattr(relay_process.robots, "read", lambda item: item)
    Robot.goes.clear()
    yield
    Robot.goes.set()


def put(src: int, payload: bytes) -> RobotMessage:
    return RobotMessage(src, PUT, "a/b", payload, monotonic_ns())


def test_a_robot_that_takes_nothing_delays_no_other_one() -> None:
    """It keeps as much waiting as fits, and loses the rest; the result names it, and the host was in time."""
    count, fit = 100, ROBOT_WAITING.bytes // SIZE
    served = Served([(1, 2), (1, 3)])
    for number in range(count):
        served.queue.put(put(1, bytes([number]) * SIZE))
        wait_for(lambda n=number: len(served.robots[3].taken) > n, LIMIT_S, "it at the fast one")  # type: ignore[misc]
    assert not served.robots[2].taken
    fates, report = served.end()
    causes = Counter((fate.dst, fate.cause) for fate in fates)
    assert causes == {
        (3, Cause.DELIVERED): count, (2, Cause.RECEIVER): count - fit, (2, Cause.IN_FLIGHT): fit,
    }  # fmt: skip
    assert any(note.startswith("slow ") and f"did not take {count - fit} messages" in note for note in report.notes)
    assert report.closing is not None
    assert report.closing["late"]["count"] == count


def test_what_waits_for_a_relay_that_is_behind_is_bounded_and_its_sender_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A flood of one robot takes no room from another one."""
    monkeypatch.setattr(robot_queues, "RELAY_WAITING", RELAY_WAITING._replace(items=10))
    goes, reads = Event(), Event()

    def read(item: Any) -> Any:
        reads.set()
        goes.wait(LIMIT_S)
        return item

    monkeypatch.setattr(relay_process.robots, "read", read)
    served = Served([(1, 3), (2, 3)])
    talker, slow = served.process._inlets[1], served.process._inlets[2]
    for number in range(31):
        talker.offer(put(1, b"x"), 1, partial(Unfit, PUT, "a/b", 1))
        if number == 0:
            assert reads.wait(LIMIT_S)  # and waits with the first one
    slow.offer(put(2, b"last"), 4, partial(Unfit, PUT, "a/b", 4))
    goes.set()
    wait_for(lambda: len(served.robots[3].taken) == 11, LIMIT_S, "what fitted")
    for _ in range(10):  # there is room again
        talker.offer(put(1, b"x"), 1, partial(Unfit, PUT, "a/b", 1))
    wait_for(lambda: len(served.robots[3].taken) == 21, LIMIT_S, "as much again")
    fates, report = served.end()
    causes = Counter((fate.src, fate.cause, fate.key, fate.size) for fate in fates)
    assert causes == {
        (1, Cause.DELIVERED, "a/b", 1): 20, (1, Cause.QUEUE, "a/b", 1): 21, (2, Cause.DELIVERED, "a/b", 4): 1,
    }  # fmt: skip
    assert any(note.startswith("talker: more than") and "21 were lost (queue)" in note for note in report.notes)


def test_a_datagram_that_the_system_refuses_or_that_has_no_receiver_is_not_delivered() -> None:
    port, other = Port(1, 0, 3, "127.0.0.1", 9), Port(3, 0, 1, "127.0.0.1", 0)
    served = Served([(1, 3), (3, 1)], (port, other))
    served.queue.put(RobotMessage(1, DATAGRAM, "udp/0", bytes(100_000), monotonic_ns(), port, 3))  # too long
    served.queue.put(RobotMessage(3, DATAGRAM, "udp/0", b"x", monotonic_ns(), other, 1))  # it never spoke
    served.queue.put(RobotMessage(1, DATAGRAM, "udp/0", b"x", monotonic_ns(), port, 3))
    served.queue.put(put(1, b"last"))
    wait_for(lambda: served.robots[3].taken, LIMIT_S, "the last")
    fates, report = served.end()
    found = [(fate.src, fate.cause) for fate in fates if fate.kind == DATAGRAM]
    assert sorted(found) == [(1, Cause.DELIVERED), (1, Cause.RECEIVER), (3, Cause.RECEIVER)]
    assert any("cannot be sent to 127.0.0.1:9: Message too long" in note for note in report.notes)


def test_a_port_may_be_on_another_address_of_the_machine() -> None:
    port = Port(1, 0, 3, "127.0.0.1", 9, "127.0.0.3")
    served = Served([(1, 3)], (port,))
    (bound,) = served.process._sockets.values()
    assert bound.getsockname()[0] == "127.0.0.3"
    served.end()


_EVENTS = st.lists(st.tuples(st.integers(1, 3), st.sampled_from("ab"), st.booleans()), max_size=20)


@given(_EVENTS)
def test_a_token_is_shown_where_a_robot_that_has_it_reaches(events: list[tuple[int, str, bool]]) -> None:
    """However many robots have the same one, and in whatever order they go."""
    links = [(1, 2), (1, 3), (2, 3), (3, 2)]
    served, have = Served(links), dict[str, set[int]]()
    Robot.goes.set()
    for robot, key, alive in events:
        served.queue.put(Token(robot, key, alive))
        (have.setdefault(key, set()).add if alive else have.setdefault(key, set()).discard)(robot)
    served.queue.put(put(1, b"last"))
    wait_for(lambda: served.robots[2].taken and served.robots[3].taken, LIMIT_S, "the last")
    for dst in (1, 2, 3):
        expected = {key for key, robots in have.items() if any((src, dst) in links for src in robots)}
        assert served.robots[dst].shown == expected
    served.end()


def test_what_a_job_raises_is_said_once_and_the_robot_is_still_served(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(robot: Robot, token: str) -> None:
        raise ValueError("no such token")

    monkeypatch.setattr(Robot, "mirror", fails)
    served = Served([(1, 3)])
    for key in ("a", "b"):
        served.queue.put(Token(1, key, True))
    served.queue.put(put(1, b"last"))
    wait_for(lambda: served.robots[3].taken, LIMIT_S, "the last")
    fates, report = served.end()
    assert [fate.cause for fate in fates] == [Cause.DELIVERED]
    assert report.notes == ["fast: ValueError: no such token"]


def test_what_the_console_watches_is_told_whether_the_network_carries_it_or_not() -> None:
    """With its time, also while programs get ready; the network of that time is forgotten, and has no fates."""
    port, other = Port(1, 0, 3, "127.0.0.1", 9), Port(2, 0, 3, "127.0.0.1", 9)
    served = Served([], (port, other), begins=False, watched=(Watched(1, "udp/0"), Watched(3, "udp/0")), ticks=200)
    before = monotonic_ns()
    for number, at in enumerate((port, other, port)):
        served.queue.put(relay_process._Datagram(at, before + number, bytes([number]), ("127.0.0.1", 5)))
    served.tell(op="begin", at_ns=monotonic_ns() + 50_000_000)
    fates, report = served.rest()
    assert [(one.which, one.at_ns - before, one.payload) for one in served.watched] == [(0, 0, b"\0"), (0, 2, b"\2")]
    assert (fates, report.until) == ([], 200)  # it ends by itself


def test_a_fault_that_comes_before_the_run_begins_is_kept_and_begins_with_it() -> None:
    """The network of the time before it forgets all else, and has no faults."""
    served = Served([(1, 3)], begins=False)
    served.tell(op="faults", faults=[fault_values(NetFault("f", 0, None, "down", ((1, 3),)))])
    wait_for(lambda: served.process._faults, LIMIT_S, "the fault")
    served.queue.put(put(1, b"before"))
    wait_for(lambda: served.robots[3].taken, LIMIT_S, "what was sent before")
    begin, process = monotonic_ns() + 20_000_000, served.process
    served.tell(op="begin", at_ns=begin)
    wait_for(lambda: process._relay._begin_ns == begin, LIMIT_S, "the network of the run")
    served.queue.put(put(1, b"x"))
    wait_for(served.queue.empty, LIMIT_S, "what is taken")
    fates, _ = served.end()
    assert [fate.cause for fate in fates] == [Cause.DOWN]
