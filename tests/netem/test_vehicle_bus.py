"""The bus of a vehicle: what is sent arrives, whoever comes, goes and comes again."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from queue import SimpleQueue

import pytest

from netem.errors import BusError
from netem.wire.session import MAX_BYTES
from netem.wire.vehicle_bus import AgentEnd, Ends, Inbound


class Channel:
    """Stands for the channel of zenoh: a test puts into it."""

    def __init__(self) -> None:
        self.puts: SimpleQueue[tuple[str, bytes]] = SimpleQueue()

    def get(self) -> tuple[str, bytes]:
        return self.puts.get()


OPEN: list[socket.socket] = []


@pytest.fixture
def ends() -> Iterator[Ends]:
    made = Ends()
    yield made
    made.close()
    while OPEN:
        OPEN.pop().close()


@pytest.fixture
def channel() -> Channel:
    return Channel()


@pytest.fixture
def world(ends: Ends, channel: Channel) -> Iterator[Inbound]:
    made = Inbound(channel, 8, ends.of_world, "cmd/{}".format)  # type: ignore[arg-type]
    yield made
    OPEN.extend(end for *_, end in made._ends.values())


def agent(ends: Ends, i: int = 3) -> AgentEnd:
    OPEN.append(ends.new(i))
    return AgentEnd(OPEN[-1], f"nav/{i}")


def test_messages_go_both_ways_whole_and_in_order(ends: Ends, world: Inbound) -> None:
    three, four = agent(ends), agent(ends, 4)
    three.put(b"a" * MAX_BYTES)
    three.put(b"b")
    assert [world.get(), world.get()] == [("cmd/3", b"a" * MAX_BYTES), ("cmd/3", b"b")]
    four.put(b"c")
    assert world.get() == ("cmd/4", b"c")
    assert world.put(3, b"d") and world.put(3, b"e") and world.put(4, b"f")
    assert [three.get(), three.poll(), three.poll()] == [("nav/3", b"d"), ("nav/3", b"e"), None]
    assert four.get() == ("nav/4", b"f")


def test_puts_of_zenoh_come_with_them_in_their_order(ends: Ends, channel: Channel, world: Inbound) -> None:
    three = agent(ends)
    assert world.poll() is None
    for number in range(20):  # more than wait here: the rest waits in the channel
        channel.puts.put(("cmd/grant", bytes([number])))
    three.put(b"x")
    came = [world.get() for _ in range(21)]
    assert [data for key, data in came if key == "cmd/grant"] == [bytes([number]) for number in range(20)]
    assert ("cmd/3", b"x") in came


def test_nobody_has_a_bus_before_the_console_gives_him_one(ends: Ends, world: Inbound) -> None:
    assert not world.put(3, b"d")
    agent(ends, 4).put(b"x")
    world.get()
    assert not world.put(3, b"d") and world.put(4, b"d")


def test_what_an_agent_sent_before_it_ended_arrives_and_what_comes_later_is_lost(ends: Ends, world: Inbound) -> None:
    end = ends.new(3)
    AgentEnd(end, "nav/3").put(b"last")
    end.close()
    assert world.get() == ("cmd/3", b"last")
    assert world.put(3, b"d")  # lost, as on a key that nobody subscribes to
    assert world.poll() is None
    assert not world.put(3, b"d")


def test_the_next_life_takes_the_place_of_the_one_before(ends: Ends, world: Inbound) -> None:
    first = agent(ends)
    first.put(b"1")
    world.get()
    second = agent(ends)
    second.put(b"2")
    assert world.get() == ("cmd/3", b"2")
    assert world.put(3, b"d") and second.get() == ("nav/3", b"d")
    with pytest.raises(BusError):
        first.get()


def test_an_agent_learns_that_the_world_has_ended() -> None:
    ours, worlds = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    end = AgentEnd(ours, "nav/3")
    worlds.close()
    for call in (end.get, end.poll, lambda: end.put(b"x")):
        with pytest.raises(BusError):
            call()
    ours.close()


def test_a_message_that_is_too_long_for_zenoh_is_too_long_here(ends: Ends, world: Inbound) -> None:
    with pytest.raises(BusError):
        agent(ends).put(bytes(MAX_BYTES + 1))


def test_no_new_life_begins_when_the_world_has_ended(ends: Ends) -> None:
    ends.of_world.close()
    with pytest.raises(BrokenPipeError):
        ends.new(3)


def test_the_world_goes_on_when_the_console_has_ended(ends: Ends, world: Inbound) -> None:
    three = agent(ends)
    ends._world.close()
    three.put(b"x")
    assert world.get() == ("cmd/3", b"x")
