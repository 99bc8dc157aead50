"""A WHOI Micro-Modem: canned dialogues, on TCP and on a pseudo terminal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from modem_water import ModemClient, Water

from fleet.addons.robots.modems.micromodem import MicroModem, checksum, sentence
from fleet.addons.robots.modems.modem import RANGING, ModemCore
from netem.cause import Cause
from netem.errors import BusError

MINI, FRAME, ANSWER = 32, 33, 34


class Program(ModemClient):
    """A client, sentence by sentence."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        assert [self.hears()[0] for _ in range(2)] == ["CAREV", "CAREV"]

    def says(self, kind: str, *values: object) -> None:
        self.socket.sendall(sentence(kind, *values))

    def hears(self) -> list[str]:
        """The next sentence, word by word; its checksum is right."""
        text = self.file.readline().decode().strip()
        body, _, given = text.removeprefix("$").partition("*")
        assert given == checksum(body)
        return body.split(",")


@pytest.fixture
def water() -> Iterator[Water]:
    with closing(Water(MicroModem)) as found:
        yield found


@pytest.fixture
def program(water: Water) -> Iterator[Program]:
    with closing(Program(water.port)) as found:
        yield found


def test_the_checksum_is_that_of_nmea() -> None:
    assert checksum("GPGLL,5300.97914,N,00259.98174,E,125926,A") == "28"  # a well-known sentence


def test_configuration(program: Program) -> None:
    program.says("CCCFQ", "SRC")
    assert program.hears() == ["CACFG", "SRC", "1"]
    program.says("CCCFG", "TXP", 3)
    assert program.hears() == ["CACFG", "TXP", "3"]
    program.says("CCCFG", "SRC", 9)
    assert program.hears() == ["CACFG", "SRC", "9"]
    program.says("CCCFG", "SRC", 127)  # that is everybody's
    assert program.hears()[-1] == "NO ADDRESS 127"
    program.says("CCCFQ", "SRC")
    assert program.hears() == ["CACFG", "SRC", "9"]
    program.says("CCALQ", 0)
    assert program.hears()[:2] == ["CAALQ", "0"]
    program.says("CCCLQ")
    assert program.hears()[:4] == ["CACLK", "2026", "1", "1"]


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (b"$CCXYZ,1\r\n", "UNKNOWN COMMAND CCXYZ"),
        (b"$CCCFQ,SRC*00\r\n", "BAD CHECKSUM 00"),
        (b"CCCFQ,SRC\r\n", "NMEA sentence expected"),
        (b"$CCMPC,1\r\n", "BAD PARAMETER IN CCMPC"),
        (b"$CCMPC,1,128\r\n", "NO ADDRESS 128"),
        (b"$CCMUC,1,2,FFFF\r\n", "13 BITS"),
        (b"$CCTXD,1,2,0,00\r\n", "NO DATA WERE ASKED FOR"),
        (b"$CCCYC,0,1,2,9,0,1\r\n", "RATE 9"),
        (b"\xff\xfe$\x00*,\r\n", "NMEA sentence expected"),
    ],
)
def test_what_cannot_be_obeyed_is_told(program: Program, said: bytes, words: str) -> None:
    program.socket.sendall(said)
    kind, _, _, _, told = program.hears()
    assert kind == "CAERR" and words in told


def test_a_mini_packet(program: Program, water: Water) -> None:
    program.says("CCMUC", 1, 2, "1ABC")
    assert program.hears() == ["CAMUC", "1", "2", "1ABC"]
    request = water.sends()
    assert (request.to, request.what, request.payload) == (2, MINI, b"\x1a\xbc")
    assert [program.hears()[0] for _ in range(2)] == ["CATXP", "CATXF"]
    water.brings(2, b"\x0f\x00", what=MINI, left=1.0, came=1.1)
    assert program.hears() == ["CAMUA", "2", "1", "0F00"]


def test_a_ping_has_the_one_way_time(program: Program, water: Water) -> None:
    program.says("CCMPC", 1, 2)
    assert program.hears() == ["CAMPC", "1", "2"]
    water.sends(at_s=1.0)
    answer = water.at(1.4).to_bytes(8, "little")
    water.brings(2, answer, what=RANGING, left=4.4, came=4.8)
    assert program.hears() == ["CAMPR", "2", "1", "0.4000"]


def test_a_cycle_of_two_frames_is_acknowledged(program: Program, water: Water) -> None:
    program.says("CCCYC", 0, 1, 2, 1, 1, 2)
    assert program.hears() == ["CACYC", "0", "1", "2", "1", "1", "2"]
    for number, data in ((1, "AA"), (2, "BBCC")):
        kind, _, *rest = program.hears()
        assert (kind, rest) == ("CADRQ", ["1", "2", "1", "60", str(number)])  # 64 bytes, but for our header
        program.says("CCTXD", 1, 2, 1, data)
        assert program.hears() == ["CATXD", "1", "2", "1", str(len(data) // 2)]
    first, second = water.sends(), water.sends()
    assert (first.payload, second.payload) == (bytes((1, 1, 1, 2)) + b"\xaa", bytes((1, 1, 2, 2)) + b"\xbb\xcc")
    assert [program.hears() for _ in range(2)] == [["CATXP", "3"], ["CATXF", "3"]]
    water.brings(2, b"\x03", what=ANSWER, left=5.0, came=5.5)
    assert [program.hears() for _ in range(2)] == [["CAACK", "2", "1", "1", "1"], ["CAACK", "2", "1", "2", "1"]]


def test_a_packet_that_comes(program: Program, water: Water) -> None:
    for number, data in ((1, b"\xaa"), (2, b"\xbb")):
        water.brings(2, bytes((1, 1, number, 2)) + data, what=FRAME, left=float(number), came=number + 0.5)
    heard = [program.hears() for _ in range(5)]
    assert heard[:4] == [
        ["CACYC", "1", "2", "1", "1", "1", "2"],
        ["CARXP", "1"],
        ["CARXD", "2", "1", "1", "1", "AA"],
        ["CARXD", "2", "1", "1", "2", "BB"],
    ]
    kind, version, mode, *rest = heard[4]
    assert (kind, version, mode, rest[11:17]) == ("CACST", "6", "0", ["1", "2", "1", "0", "0", "2"])
    assert (water.next().payload, len(rest)) == (b"\x03", 28)


def test_a_collision_is_a_bad_frame(program: Program, water: Water) -> None:
    water.core.spoiled(Cause.COLLISION, water.at(3.0))
    assert program.hears() == ["CAMSG", "BAD_CRC", "1"]
    kind, _, mode, *rest = program.hears()
    assert (kind, mode, rest[16:18]) == ("CACST", "1", ["1", "1"])


def test_a_packet_of_the_second_generation(program: Program, water: Water) -> None:
    program.says("CCTDP", 2, 1, 0, 0, "DEADBEEF")
    assert program.hears()[:5] == ["CATDP", "0", "1", "2", "1"]
    assert water.sends().payload == bytes((1, 2, 1, 1)) + bytes.fromhex("DEADBEEF")
    assert [program.hears()[0] for _ in range(2)] == ["CATXP", "CATXF"]
    water.brings(2, bytes((1, 2, 1, 1)) + b"\x01\x02", what=FRAME, left=1.0, came=1.5)
    assert program.hears() == ["CARDP", "2", "1", "1", "0", "0", "1;2;0102"]


def test_a_terminal_is_opened_by_its_path_and_is_gone_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "ttyAUV"
    core = ModemCore(1, MicroModem, terminal=str(path))
    water = Water(MicroModem, core=core)
    with open(path, "r+b", buffering=0) as terminal:
        os.write(terminal.fileno(), sentence("CCCFQ", "SRC"))
        said = b""
        while b"CACFG,SRC,1" not in said:
            said += os.read(terminal.fileno(), 4096)
    water.core.close()
    assert not path.is_symlink()


def test_a_terminal_takes_no_place_of_something_else(tmp_path: Path) -> None:
    (tmp_path / "tty").write_text("mine")
    with pytest.raises(BusError, match="cannot make the terminal"):
        ModemCore(1, MicroModem, terminal=str(tmp_path / "tty")).listen()
    assert (tmp_path / "tty").read_text() == "mine"
