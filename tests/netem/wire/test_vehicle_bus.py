"""The bus of a vehicle: what is sent arrives, whoever comes, goes and comes again."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread

import pytest

from netem.errors import BusError
from netem.limits import WIRE_MESSAGE
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
    three.put(b"a" * WIRE_MESSAGE.bytes)
    three.put(b"b")
    assert [world.get(), world.get()] == [("cmd/3", b"a" * WIRE_MESSAGE.bytes), ("cmd/3", b"b")]
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
        agent(ends).put(bytes(WIRE_MESSAGE.bytes + 1))


def test_no_new_life_begins_when_the_world_has_ended(ends: Ends) -> None:
    ends.of_world.close()
    with pytest.raises(BrokenPipeError):
        ends.new(3)


def test_the_world_goes_on_when_the_console_has_ended(ends: Ends, world: Inbound) -> None:
    three = agent(ends)
    ends._world.close()
    three.put(b"x")
    assert world.get() == ("cmd/3", b"x")


# --- many at a time ---------------------------------------------------------

LIMIT_S = 60.0


@contextmanager
def meanwhile(*works: Callable[[], object]) -> Iterator[list[Thread]]:
    """Do all this in threads of their own, which have ended when the block ends."""
    threads = [Thread(target=work, daemon=True) for work in works]
    for thread in threads:
        thread.start()
    yield threads
    for thread in threads:
        thread.join(LIMIT_S)
        assert not thread.is_alive()


def test_many_vehicles_talk_at_once_and_each_in_its_order(ends: Ends, channel: Channel, world: Inbound) -> None:
    """Also while zenoh puts, and while the console hands over the ends of further vehicles."""
    vehicles, count = range(1, 31), 100
    talking = {i: agent(ends, i) for i in vehicles}

    def talk(i: int) -> Callable[[], None]:
        return lambda: [talking[i].put(b"%d" % n) for n in range(count)] and None

    def hand_over() -> None:
        for i in range(31, 61):
            agent(ends, i).put(b"here")

    def put() -> None:
        for n in range(count):
            channel.puts.put(("cmd/grant", b"%d" % n))

    came: dict[str, list[bytes]] = {}
    with meanwhile(put, hand_over, *map(talk, vehicles)):
        for _ in range(len(vehicles) * count + count + 30):
            key, data = world.get()
            came.setdefault(key, []).append(data)
    in_order = [b"%d" % n for n in range(count)]
    expected = {f"cmd/{i}": in_order for i in vehicles} | {f"cmd/{i}": [b"here"] for i in range(31, 61)}
    assert came == expected | {"cmd/grant": in_order}


def test_questions_and_answers_of_many_vehicles_do_not_mix(ends: Ends, world: Inbound) -> None:
    """Each agent answers a nav with its own number and that of the nav, as in lockstep."""
    vehicles, ticks = range(1, 11), 50
    answering = {i: agent(ends, i) for i in vehicles}

    def answer(i: int) -> Callable[[], None]:
        def work() -> None:
            for _ in range(ticks):
                key, data = answering[i].get()
                assert key == f"nav/{i}"
                answering[i].put(data + b" by %d" % i)

        return work

    with meanwhile(*map(answer, vehicles)):
        for i in vehicles:
            answering[i].put(b"hello")
        assert {world.get() for _ in vehicles} == {(f"cmd/{i}", b"hello") for i in vehicles}
        for tick in range(ticks):
            assert all(world.put(i, b"%d" % tick) for i in vehicles)
            assert {world.get() for _ in vehicles} == {(f"cmd/{i}", b"%d by %d" % (tick, i)) for i in vehicles}


# --- more than the buffers hold ---------------------------------------------

MANY = 100  # of the longest messages: 4.8 MB, and buffers hold some 200 kB by default


def long(n: int) -> bytes:
    return b"%d" % n + bytes(WIRE_MESSAGE.bytes - len(b"%d" % n))


def test_an_agent_that_reads_late_is_waited_for_and_loses_nothing(ends: Ends, world: Inbound) -> None:
    three = agent(ends)
    three.put(b"hello")
    world.get()
    with meanwhile(lambda: [world.put(3, long(n)) for n in range(MANY)]) as (sending,):
        assert sending.is_alive()
        assert [three.get()[1] for _ in range(MANY)] == [long(n) for n in range(MANY)]
    assert three.poll() is None


def test_a_world_that_reads_late_is_waited_for_and_loses_nothing(ends: Ends, world: Inbound) -> None:
    three = agent(ends)
    with meanwhile(lambda: [three.put(long(n)) for n in range(MANY)]) as (sending,):
        assert sending.is_alive()
        assert [world.get() for _ in range(MANY)] == [("cmd/3", long(n)) for n in range(MANY)]
    assert world.poll() is None


def test_who_waits_for_room_is_told_of_the_end(ends: Ends, world: Inbound) -> None:
    """The agent ends while the world waits for it, and the world goes on."""
    end = ends.new(3)
    AgentEnd(end, "nav/3").put(b"hello")
    world.get()
    with meanwhile(lambda: [world.put(3, long(n)) for n in range(MANY)]) as (sending,):
        assert sending.is_alive()
        end.close()
    four = agent(ends, 4)
    four.put(b"x")
    assert world.get() == ("cmd/4", b"x")


SMALL = 4096  # bytes of a buffer, as the system of a host may have set it


def test_an_agent_is_not_told_that_the_world_has_ended_when_its_buffer_is_too_small(ends: Ends) -> None:
    end = ends.new(3)
    OPEN.append(end)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SMALL)
    with pytest.raises(BusError) as caught:
        AgentEnd(end, "nav/3").put(bytes(WIRE_MESSAGE.bytes))
    assert "closed" not in str(caught.value)


def test_the_world_does_not_lose_what_its_buffer_cannot_hold_without_a_word(ends: Ends, world: Inbound) -> None:
    three = agent(ends)
    three.put(b"hello")
    world.get()
    world._of[3].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SMALL)
    with pytest.raises(BusError):
        world.put(3, bytes(WIRE_MESSAGE.bytes))


# --- an end that is replaced -------------------------------------------------


def test_lives_follow_each_other_while_others_talk(ends: Ends, world: Inbound) -> None:
    """Descriptors are used again; each message comes under the number of its agent, and the newest life gets ours."""
    four = agent(ends, 4)
    for life in range(50):
        end = ends.new(3)
        AgentEnd(end, "nav/3").put(b"life %d" % life)
        four.put(b"%d" % life)
        assert {world.get(), world.get()} == {("cmd/3", b"life %d" % life), ("cmd/4", b"%d" % life)}
        assert world.put(3, b"nav %d" % life) and world.put(4, b"nav")
        assert AgentEnd(end, "nav/3").get() == ("nav/3", b"nav %d" % life)
        assert four.get() == ("nav/4", b"nav")
        end.close()
        assert world.poll() is None  # it sees the end
        assert not world.put(3, b"nobody")


def test_the_world_goes_on_when_a_life_ends_as_the_next_one_takes_its_place(ends: Ends, world: Inbound) -> None:
    """It learns of both at once, of the new end first; what is left of the old one is of no interest."""
    first = ends.new(3)
    AgentEnd(first, "nav/3").put(b"1")
    world.get()
    assert world.poll() is None
    ends.of_world.setblocking(False)  # so that a wait for the console is an error here
    second = agent(ends)
    first.close()
    second.put(b"2")
    assert world.get() == ("cmd/3", b"2")
