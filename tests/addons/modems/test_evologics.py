"""A modem in the language of EvoLogics: the dialogues that two public drivers hold with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from math import asin, radians

import pytest
from modem_water import ModemClient, Water

from fleet.addons.modems.evologics import BURST, INSTANT, TIMED, EvoLogics
from netem.cause import Cause
from netem.endpoint import Level, ModemRequest, Sound


class Program(ModemClient):
    """A client, as far as bytes go."""

    water: Water

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
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
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
    water.core.on_dropped(water.next().tag, Cause.MUTE)
    assert program.hears() == b"+++AT:10:FAILEDIM,2\r\n"


def test_what_comes_is_told_and_acknowledged(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
    water.core.on_reached(Sound(water.at(0.0), water.at(0.1)))
    assert program.hears() == b"+++AT:9:RECVSTART\r\n"
    water.brings(3, b"hi\n", head=bytes((1, 7, INSTANT)), what=EvoLogics.link, left=1.0, came=1.2)
    assert program.hears() == b"+++AT:30:RECVEND,1300000,30000,-101,120\r\n"
    head, flag, rest = program.hears().partition(b"ack")
    assert (head, flag, rest) == (b"+++AT:42:RECVIM,3,3,1,", b"ack", b",30000,-101,120,0.0000,hi\n")
    assert program.hears() == b"\r\n"  # the message had a line feed
    assert water.next().head == bytes((0, 7, INSTANT))
    water.brings(3, b"data\n", what=BURST, to=0, left=3.0, came=3.25)
    assert b"RECVEND" in program.hears()
    assert program.hears() == b"data\n" and not water.given  # byte by byte, in the data mode
    assert program.asks(b"+++ATC\n") == b"+++ATC:2:OK\r\n"
    water.brings(3, b"data", what=BURST, to=0, left=3.0, came=3.25)
    assert program.hears().startswith(b"RECVEND")
    assert program.hears() == b"RECV,4,3,255,800,-101,120,250000,0.0000,data\r\n"


def test_data_go_to_the_remote_address(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
    program.says(b"nobody has this\n")
    assert program.asks(b"+++AT!AR3\n") == b"+++AT!AR:2:OK\r\n"
    program.says(b"some data\n")
    request = water.sends()
    assert (request.to, request.payload) == (3, b"some data\n")
    assert program.hears().startswith(b"+++AT:") and program.hears().startswith(b"+++AT:")
    water.brings(3, b"", head=acknowledges(request), what=EvoLogics.link, left=2.0, came=2.5)
    assert program.hears() == b"+++AT:13:DELIVERED,1,3\r\n"


def test_bytes_of_the_data_mode_leave_without_a_line_feed(program: Program, water: Water) -> None:
    """Also in front of a command, and in pieces as long as the modem takes."""
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
    assert program.asks(b"+++AT!AR3\n") == b"+++AT!AR:2:OK\r\n"
    program.says(b"raw")
    assert water.sends().payload == b"raw"
    assert [program.hears()[:5] for _ in range(2)] == [b"+++AT"] * 2
    assert program.asks(b"more+++AT?AR\n") == b"+++AT?AR:1:3\r\n"
    assert water.sends().payload == b"more"
    program.says(b"x" * 200)
    assert [len(water.sends().payload) for _ in range(3)] == [64, 64, 64]
    assert not water.core.remark  # what waits is not refused


def test_data_that_found_no_room_leave_when_there_is_some(program: Program, water: Water) -> None:
    """Nothing of them is on its way, so no acknowledgement calls for them."""
    assert program.asks(b"+++AT!AR3\n") == b"+++AT!AR:2:OK\r\n"
    for _ in range(3):
        assert program.asks(b"+++AT*SENDIM,1,2,noack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    program.says(b"data\n")
    assert program.asks(b"+++AT?AR\n") == b"+++AT?AR:1:3\r\n"
    assert [water.sends().payload for _ in range(4)] == [b"x", b"x", b"x", b"data\n"]


@pytest.mark.parametrize("to", [2, 255])
def test_burst_data_longer_than_a_frame_arrive_at_once(program: Program, water: Water, to: int) -> None:
    """In pieces, each of which is acknowledged if they are for one modem; the other side is told once."""
    data = bytes(range(65, 91)) * 6
    assert program.asks(b"+++AT*SEND,156,%d," % to + data + b"\n") == b"+++AT*SEND:2:OK\r\n"
    pieces = []
    for _ in range(3):
        pieces.append(water.sends())
        if to != 255:
            head = acknowledges(pieces[-1])
            water.brings(2, b"", head=head, what=EvoLogics.link, left=2.0, came=2.5)
    if to != 255:
        assert program.hears() == b"+++AT:13:DELIVERED,1,2\r\n"
    assert program.asks(b"+++ATC\n") == b"+++ATC:2:OK\r\n"
    for piece in pieces:
        water.brings(3, piece.payload, head=piece.head, what=piece.what, left=3.0, came=3.25)
    assert program.hears().startswith(b"RECV,156,3,") and not water.core.remark


def test_burst_data_end_with_the_piece_that_fails(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT*SEND,100,2," + b"x" * 100 + b"\n") == b"+++AT*SEND:2:OK\r\n"
    water.core.on_dropped(water.next().tag, Cause.MUTE)
    assert program.hears() == b"+++AT:10:FAILED,0,2\r\n" and not water.given


def test_the_escape_needs_no_line_feed(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Rock's driver writes it, with a second before and behind it."""
    monkeypatch.setattr("fleet.addons.modems.evologics.ESCAPE_S", 0.0)
    assert program.asks(b"+++") == b"OK\r\n"
    assert program.asks(b"AT?AL\n") == b"1\r\n"


def test_data_for_nobody_are_told_in_the_result(program: Program, water: Water) -> None:
    """Most often it is a driver that says AT to a port in the data mode."""
    program.says(b"AT!L3\n")
    assert program.asks(b"+++AT?AL\n") == b"+++AT?AL:1:1\r\n"
    assert "mode: command" in water.core.remark and not water.given


@pytest.fixture
def commands() -> Iterator[Program]:
    with closing(Water(partial(EvoLogics, "command"))) as water, closing(Program(water.port)) as found:
        found.water = water
        yield found


def test_a_port_may_begin_in_the_command_mode(commands: Program) -> None:
    """The beginnings of DUNE and of oceansystemslab, which say AT without `+++`."""
    for said, answer in ((b"ATI0\n", b"1.9"), (b"ATZ1\n", b"OK"), (b"ATZ3\n", b"OK"), (b"ATZ4\n", b"OK"),
                         (b"AT@CTRL\n", b"OK"), (b"AT!AL7\n", b"OK"), (b"AT!L3\n", b"OK"), (b"AT!G1\n", b"OK"),
                         (b"AT!ZI60\n", b"OK"), (b"AT!RC2\n", b"OK"), (b"AT!RI0\n", b"OK"), (b"AT!RT4000\n", b"OK"),
                         (b"AT@ZX1\n", b"OK"), (b"AT!RP0\n", b"OK"), (b"AT!AM15\n", b"OK"), (b"AT!CA1490\n", b"OK"),
                         (b"AT?CA\n", b"1490"), (b"AT?AM\n", b"15"), (b"AT!C0\n", b"OK"), (b"AT@ZU1\n", b"OK"),
                         (b"AT?CLOCK\n", b"0"), (b"ATA\n", b"INITIATION LISTEN"), (b"AT?S\n", b"INITIATION LISTEN"),
                         (b"AT?AL\n", b"7"), (b"AT!RP1\n", b"ERROR OUT OF RANGE"), (b"ATH1\n", b"OK"),
                         (b"AT@ZX2\n", b"ERROR OUT OF RANGE"), (b"AT&X\n", b"ERROR UNKNOWN COMMAND"),
                         (b"AT!ZU1\n", b"OK"), (b"AT&W\n", b"OK")):  # fmt: skip
        assert commands.asks(said) == answer + b"\r\n"
    assert b"phy:" in commands.asks(b"ATI1\n")
    commands.says(b"ATZ0\n")  # no answer
    assert commands.asks(b"AT?AL\n") == b"7\r\n"


def test_all_settings_are_listed_and_forgotten(program: Program) -> None:
    """Rock's parser wants an empty line behind them, and two parts in each line."""
    assert program.asks(b"+++AT!L2\n") == b"+++AT!L:2:OK\r\n"
    program.says(b"+++AT&V\n")
    told = [program.hears() for _ in range(16)]
    head, _, first = told[0].rpartition(b":")[0].rpartition(b":")
    assert head.startswith(b"+++AT&V:") and first == b"Source Level" and told[-1] == b"\r\n"
    assert {b"Local Address: 1\r\n", b"Sound Speed: 1500\r\n", b"Highest Address: 3\r\n"} <= set(told)
    assert told[0].endswith(b": 2\r\n") and all(len(line.split(b":")) == 2 for line in told[1:-1])
    assert program.asks(b"+++AT&F\n") == b"+++AT&F:2:OK\r\n"
    assert program.asks(b"+++AT?L\n") == b"+++AT?L:1:0\r\n"


def test_notifications_have_to_be_switched_on(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT?ZX\n") == b"+++AT?ZX:1:0\r\n"
    assert program.asks(b"+++AT*SENDIM,1,2,noack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    water.sends()
    water.core.on_reached(Sound(water.at(0.0), water.at(0.1)))
    water.core.on_spoiled(Cause.SNR, water.at(1.0))
    water.brings(3, b"hi", what=INSTANT, left=1.0, came=1.2)
    assert b"RECVIM,2,3,1,noack" in program.hears()


def test_a_message_has_the_protocol_number_of_its_sender(program: Program, water: Water) -> None:
    """For programs that name such numbers, as evins, and for those that ask for them."""
    assert program.asks(b"+++AT*SENDIM,p3,1,2,ack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    assert water.sends().head[3:] == b"\3"
    water.brings(3, b"hi", head=bytes((1, 7, INSTANT, 5)), what=EvoLogics.link, left=1.0, came=1.2)
    assert b":RECVIM,p5,2,3,1,ack," in program.hears()
    with closing(Program(water.port)) as other:
        assert other.asks(b"+++AT!ZS4\n") == b"+++AT!ZS:2:OK\r\n" and other.asks(b"+++AT?PID\n")[-3:] == b"4\r\n"
        water.brings(3, b"hi", head=b"\5", what=INSTANT, left=1.0, came=1.2)
        assert b":RECVIM,2,3,1,noack," in other.hears()
        assert other.asks(b"+++AT@ZF1\n") == b"+++AT@ZF:2:OK\r\n"
        water.brings(3, b"hi", what=INSTANT, left=1.0, came=1.2)
        assert b":RECVIM,p0,2,3,1,noack," in other.hears()


def test_64_bytes_with_an_acknowledgement_fit_into_a_message(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT*SENDIM,64,2,ack," + b"x" * 64 + b"\n") == b"+++AT*SENDIM:2:OK\r\n"
    assert water.next().payload == b"x" * 64


@pytest.mark.parametrize(("snr", "integrity"), [(10.0, 100), (0.0, 80), (60.0, 200), (-50.0, 0)])
def test_strength_and_integrity_follow_from_the_level(
    program: Program, water: Water, snr: float, integrity: int
) -> None:
    """A signal at the limit has an integrity of 100, and what was not received has less."""
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
    water.brings(3, b"hi", what=INSTANT, left=1.0, came=1.2, level=Level(150.0, snr))
    assert program.hears().endswith(b",-71,%d\r\n" % integrity)
    assert b",-71,%d,0.0000,hi" % integrity in program.hears()
    water.core.on_spoiled(Cause.COLLISION, water.at(1.0), Level(150.0, snr))
    assert program.hears().endswith(b":RECVFAILED,0.0000,-71,%d\r\n" % min(99, integrity))


def test_a_synchronous_message_leaves_at_its_time_and_says_when_it_came(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT@ZX1\n") == b"+++AT@ZX:2:OK\r\n"
    at_us = water.core.now_us + 300_000
    assert program.asks(b"+++AT*SENDIMS,2,2,%d,hi\n" % at_us) == b"+++AT*SENDIMS:2:OK\r\n"
    request = water.next()
    assert (request.to, request.at_ns, request.payload) == (2, water.begin_ns + at_us * 1000, b"hi")
    water.core.on_dropped(request.tag, Cause.QUEUE)
    assert program.hears() == b"+++AT:12:EXPIREDIMS,2\r\n"
    assert program.asks(b"+++AT*SENDIMS,2,2,1,hi\n") == b"+++AT*SENDIMS:18:ERROR OUT OF RANGE\r\n"
    assert program.asks(b"+++AT*SENDIMS,2,2,,hi\n") == b"+++AT*SENDIMS:2:OK\r\n"
    assert b"SENDSTART,2,ims," in (water.sends(), program.hears())[1] and b"SENDEND,2,ims" in program.hears()
    water.brings(3, b"ho", what=TIMED, left=1.0, came=1.25)
    assert b"RECVEND" in program.hears()
    assert program.hears().endswith(b":RECVIMS,2,3,1,1250000,20000,-101,120,0.0000,ho\r\n")


def test_a_piggyback_message_travels_with_an_acknowledgement(program: Program, water: Water) -> None:
    assert program.asks(b"+++AT*SENDPBM,4,3,back\n") == b"+++AT*SENDPBM:2:OK\r\n"
    assert not water.given
    water.brings(3, b"hi", head=bytes((1, 7, INSTANT, 0)), what=EvoLogics.link, left=1.0, came=1.2)
    assert b":RECVIM,2,3,1,ack," in program.hears()
    answer = water.sends()
    assert (answer.to, answer.payload, answer.head) == (3, b"back", bytes((0, 7, INSTANT)))
    water.brings(3, b"hi", head=bytes((1, 8, INSTANT, 0)), what=EvoLogics.link, left=1.0, came=1.2)
    assert b":RECVIM,2,3,1,ack," in program.hears() and water.sends().payload == b""  # once
    assert program.asks(b"+++AT*SENDIM,1,2,ack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    request = water.sends()
    water.brings(2, b"pbm", head=acknowledges(request), what=EvoLogics.link, left=2.0, came=2.5)
    assert program.hears() == b"+++AT:13:DELIVEREDIM,2\r\n"
    assert program.hears().endswith(b":RECVPBM,3,2,1,30000,-101,120,0.0000,pbm\r\n")


def fields(said: bytes) -> list[str]:
    """The fields of a notification, as evins splits it: a number has a point if it is no whole one."""
    return said.decode().strip().split(":", 2)[2].split(",")


def test_an_acknowledgement_says_where_it_comes_from() -> None:
    """750 m away, to the north-east and below: the travel time is 0.5 s. The errors are below 6 standard deviations."""
    sigma = radians(0.5)
    with closing(Water(partial(EvoLogics, "data", sigma))) as water, closing(Program(water.port)) as program:
        assert program.asks(b"+++AT*SENDIM,1,2,ack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
        request = water.sends()
        away = (500.0, 500.0, 250.0)
        water.brings(2, b"", head=acknowledges(request), what=EvoLogics.link, left=2.0, came=2.5, away=away)
        assert program.hears() == b"+++AT:13:DELIVEREDIM,2\r\n"
        kind, _, at, src, *numbers = fields(program.hears())
        assert (kind, at, src, len(numbers)) == ("USBLLONG", "2.500000", "2", 13)
        assert numbers[:3] == numbers[3:6] and numbers[6:9] == ["0.0000"] * 3
        for found, true in zip(numbers[3:6], (500.0, 500.0, -250.0), strict=True):
            assert float(found) == pytest.approx(true, abs=6 * 750.0 * sigma)
        assert numbers[9:12] == ["500000", "-101", "120"]
        assert float(numbers[12]) == pytest.approx(750.0 * sigma, rel=0.01)
        water.brings(2, b"hi", what=INSTANT, left=3.0, came=3.5, away=away)
        assert fields(program.hears())[0] == "RECVIM"
        kind, _, at, src, *numbers = fields(program.hears())
        assert (kind, at, src, len(numbers)) == ("USBLANGLES", "3.500000", "2", 10)
        assert float(numbers[0]) == pytest.approx(radians(45.0), abs=6 * sigma)
        assert float(numbers[1]) == pytest.approx(-asin(1 / 3), abs=6 * sigma)
        assert float(numbers[9]) == pytest.approx(sigma, abs=1e-4)
        assert program.asks(b"+++AT@ZU0\n") == b"+++AT@ZU:2:OK\r\n"
        water.brings(2, b"hi", what=INSTANT, left=3.0, came=3.5, away=away)
        assert fields(program.hears())[0] == "RECVIM"
        assert program.asks(b"+++AT?DI\n") == b"+++AT?DI:5:EMPTY\r\n"


@pytest.mark.parametrize(
    "wrong", [b"+++AT*SENDIM,5,2,ack,toolong\n", b"+++AT*SENDIM,65,2,ack," + b"x" * 65 + b"\n", b"+++AT*SENDIM,1,2,x\n"]
)
def test_a_message_of_a_wrong_form_is_refused(program: Program, wrong: bytes) -> None:
    assert b":ERROR WRONG FORMAT\r\n" in program.asks(wrong)


@pytest.mark.parametrize("command", [b"*SEND,4097,2," + b"x" * 4097, b"*SENDIM,1,300,noack,x", b"*SENDIMS,1,2,1,x"])
def test_what_never_can_be_sent_is_not_busy(program: Program, command: bytes) -> None:
    """Else a driver would try for ever, also while something else waits."""
    assert program.asks(b"+++AT*SENDIM,1,2,noack,x\n") == b"+++AT*SENDIM:2:OK\r\n"
    assert program.asks(b"+++AT" + command + b"\n").endswith(b":18:ERROR OUT OF RANGE\r\n")


def test_a_full_queue_is_busy(program: Program) -> None:
    answers = [program.asks(b"+++AT*SENDIM,1,2,noack,x\n") for _ in range(4)]
    assert answers == [b"+++AT*SENDIM:2:OK\r\n"] * 3 + [b"+++AT*SENDIM:15:BUSY DELIVERING\r\n"]
