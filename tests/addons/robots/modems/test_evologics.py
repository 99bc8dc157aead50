"""A modem in the language of EvoLogics: the dialogues that two public drivers hold with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest
from modem_water import ModemClient, Water

from fleet.addons.robots.modems.evologics import BURST, INSTANT, EvoLogics
from netem.cause import Cause
from netem.endpoint import ModemRequest, Sound


class Program(ModemClient):
    """A client, as far as bytes go."""

    def says(self, data: bytes) -> None:
        self.socket.sendall(data)

    def hears(self) -> bytes:
        return self.file.readline()

    def asks(self, data: bytes) -> bytes:
        self.says(data)
        return self.hears()


def acknowledges(request: ModemRequest) -> bytes:
    return b"\0" + request.head[1:3]


@pytest.fixture
def water() -> Iterator[Water]:
    with closing(Water(EvoLogics)) as found:
        yield found


@pytest.fixture
def program(water: Water) -> Iterator[Program]:
    with closing(Program(water.port)) as found:
        yield found


def test_settings_are_answered_in_both_modes(program: Program) -> None:
    assert program.asks(b"+++AT?AL\n") == b"+++AT?AL:1:1\r\n"
    assert program.asks(b"+++AT!AR2\n") == b"+++AT!AR:2:OK\r\n"
    assert program.asks(b"+++ATC\n") == b"+++ATC:2:OK\r\n"
    assert program.asks(b"AT?AR\n") == b"2\r\n"
    assert program.asks(b"AT!L3\r\n") == b"OK\r\n"
    assert program.asks(b"AT!AR256\n") == b"ERROR OUT OF RANGE\r\n"
    assert program.asks(b"AT!AL255\n") == b"ERROR OUT OF RANGE\r\n"
    assert program.asks(b"AT!AL7\n") == b"OK\r\n" and program.asks(b"AT?AL\n") == b"7\r\n"
    assert program.asks(b"AT?XYZ\n") == b"ERROR UNKNOWN COMMAND\r\n"
    program.says(b"ATO\n")
    assert program.asks(b"+++AT?L\n") == b"+++AT?L:1:3\r\n"
    assert program.asks(b"+++\n") == b"OK\r\n"  # the escape leads to the command mode


@pytest.mark.parametrize("command", [b"+++AT*SENDIM,5,2,ack,hello\n", b"+++AT*SENDIM,p0,5,2,ack,hello\n"])
def test_an_instant_message_is_delivered(program: Program, water: Water, command: bytes) -> None:
    assert program.asks(command) == b"+++AT*SENDIM:2:OK\r\n"
    request = water.sends()
    assert (request.to, request.payload) == (2, b"hello")
    assert [program.hears().split(b",")[0] for _ in range(2)] == [b"+++AT:23:SENDSTART", b"+++AT:27:SENDEND"]
    water.brings(2, b"", head=acknowledges(request), what=EvoLogics.link, left=2.0, came=2.5)
    assert program.hears() == b"+++AT:13:DELIVEREDIM,2\r\n"
    assert program.asks(b"+++AT?T\n") == b"+++AT?T:6:500000\r\n"


def test_a_message_with_line_feeds_is_whole(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT*SENDIM,5,2,noack,a\nb\nc\n") == b"+++AT*SENDIM:2:OK\r\n"
    assert water.next().payload == b"a\nb\nc"


def test_an_instant_message_that_the_water_loses_has_failed(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT*SENDIM,1,2,ack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    water.core.dropped(water.next().tag, Cause.MUTE)
    assert program.hears() == b"+++AT:10:FAILEDIM,2\r\n"


def test_what_comes_is_told_and_acknowledged(program: Program, water: Water) -> None:
    program.asks(b"+++AT?AL\n")
    water.core.reached(Sound(water.at(0.0), water.at(0.1)))
    assert program.hears() == b"+++AT:9:RECVSTART\r\n"
    water.brings(3, b"hi\n", head=bytes((1, 7, INSTANT)), what=EvoLogics.link, left=1.0, came=1.2)
    assert program.hears() == b"+++AT:27:RECVEND,1300000,60000,0,100\r\n"
    head, flag, *_ = program.hears().partition(b"ack")
    assert head == b"+++AT:39:RECVIM,3,3,1," and flag == b"ack"
    assert program.hears() == b"\r\n"  # the message had a line feed
    assert water.next().head == bytes((0, 7, INSTANT))
    water.brings(3, b"data", what=BURST, to=0, left=3.0, came=3.25)
    assert b"RECVEND" in program.hears()
    assert program.hears().startswith(b"+++AT:41:RECV,4,3,255,") and not water.given


def test_data_go_to_the_remote_address(program: Program, water: Water) -> None:
    program.says(b"nobody has this\n")
    assert program.asks(b"+++AT!AR3\n") == b"+++AT!AR:2:OK\r\n"
    program.says(b"some data\n")
    request = water.sends()
    assert (request.to, request.payload) == (3, b"some data")
    assert program.hears().startswith(b"+++AT:") and program.hears().startswith(b"+++AT:")
    water.brings(3, b"", head=acknowledges(request), what=EvoLogics.link, left=2.0, came=2.5)
    assert program.hears() == b"+++AT:13:DELIVERED,1,3\r\n"


@pytest.mark.parametrize(
    "wrong", [b"+++AT*SENDIM,5,2,ack,toolong\n", b"+++AT*SENDIM,65,2,ack," + b"x" * 65 + b"\n", b"+++AT*SENDIM,1,2,x\n"]
)
def test_a_message_of_a_wrong_form_is_refused(program: Program, wrong: bytes) -> None:
    assert b":ERROR WRONG FORMAT\r\n" in program.asks(wrong)


def test_a_full_queue_is_busy(program: Program) -> None:
    answers = [program.asks(b"+++AT*SENDIM,1,2,noack,x\n") for _ in range(4)]
    assert answers == [b"+++AT*SENDIM:2:OK\r\n"] * 3 + [b"+++AT*SENDIM:15:BUSY DELIVERING\r\n"]
