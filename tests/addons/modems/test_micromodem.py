"""A WHOI Micro-Modem: canned dialogues, on TCP and on a pseudo terminal."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from modem_water import LIMIT_S, ModemClient, Water
from waiting import wait_for

from fleet.addons.modems.line_port import MOST_LINE, MOST_UNREAD
from fleet.addons.modems.micromodem import ANSWER, DEFAULTS, FRAME, MINI, MicroModem, checksum, sentence
from fleet.addons.modems.micromodem_clock import ModemClock
from fleet.addons.modems.modem import RANGING, ModemCore
from netem.cause import Cause
from netem.errors import BusError


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


@pytest.mark.parametrize(
    ("said", "told"),
    [("recv.base64data,1", "recv.base64data,1"), ("rxp,0", "RXP,0"), ("psk.packet.mod_hdr_version,0", None),
     ("XYZ,07", None)],
)  # fmt: skip
def test_a_parameter_of_any_name_is_kept_as_it_was_written(program: Program, said: str, told: str | None) -> None:
    """Goby3 waits for the echo of the same text, for ever if it does not come."""
    told = told or said
    program.says("CCCFG", *said.split(","))
    assert ",".join(program.hears()) == f"CACFG,{told}"
    program.says("CCCFQ", told.split(",")[0])
    assert ",".join(program.hears()) == f"CACFG,{told}"


@pytest.mark.parametrize(
    "said", [("CCCFG", "CST", "x"), ("CCCFG", "a b", "1"), ("CCCFG", "abcd", ""), ("CCCFG", "XST")]
)
def test_a_parameter_that_cannot_be_is_refused(program: Program, said: tuple[str, ...]) -> None:
    program.says(*said)
    assert program.hears()[0] == "CAERR"


def test_all_parameters_are_told_and_forgotten(program: Program) -> None:
    program.says("CCCFG", "ABC", 5)
    program.says("CCCFQ", "TOP")
    told = [program.hears() for _ in range(len(DEFAULTS) + 2)]
    assert told[0] == told[-1] == ["CACFG", "ABC", "5"] and ["CACFG", "SRC", "1"] in told
    program.says("CCCFG", "ALL", 0)
    assert program.hears() == ["CACFG", "ALL", "0"]
    program.says("CCCFQ", "ABC")
    assert program.hears()[0] == "CAERR"


def test_messages_that_are_switched_off_are_not_said(program: Program, water: Water) -> None:
    for name in ("TXP", "TXF", "XST", "CST", "RXP"):
        program.says("CCCFG", name, 0)
        assert program.hears() == ["CACFG", name, "0"]
    program.says("CCMUC", 1, 2, "1ABC")
    assert program.hears()[0] == "CAMUC"
    water.sends()
    water.brings(2, b"\xaa", head=bytes((9, 1, 0, 1, 1)), what=FRAME, left=1.0, came=1.5)
    assert [program.hears()[0] for _ in range(2)] == ["CACYC", "CARXD"]
    program.says("CCCFQ", "SRC")
    assert program.hears()[0] == "CACFG"


@pytest.mark.parametrize(
    ("command", "values", "answer"),
    [("CCCLK", (2026, 11, 29, 17, 59, 60), ["CACLK", "2026", "11", "29", "18", "0", "0"]),
     ("CCTMS", ("2026-11-29T18:00:00Z", 0), ["CATMS", "0", "2026-11-29T18:00:00Z"]),
     ("CCTMS", ("2026-11-29T18:00:00ZZ", 1), ["CATMS", "0", "2026-11-29T18:00:00Z"])],
)  # fmt: skip
def test_the_clock_is_set_at_the_next_second(
    program: Program, monkeypatch: pytest.MonkeyPatch, command: str, values: tuple[Any, ...], answer: list[str]
) -> None:
    """Drivers say the second to come."""
    asked: list[float] = []
    monkeypatch.setattr(ModemClock, "wait_s", staticmethod(lambda: asked.append(0.0) or 0.0))
    program.says("CCTMQ", 0)
    kind, date, source, _ = program.hears()
    assert (kind, date[:11], source) == ("CATMQ", "2026-01-01T", "NONE")
    program.says(command, *values)
    assert program.hears() == answer and len(asked) == 1
    program.says("CCTMQ", 0)
    _, date, source, _ = program.hears()
    assert date.startswith("2026-11-29T18:0") and source == "USER_CMD"


def test_the_next_second_is_that_of_this_machine() -> None:
    assert 0.0 < ModemClock.wait_s() <= 1.0


@pytest.mark.parametrize(
    "said",
    [("CCTMS", "yesterday", 0), ("CCTMS", "2026-11-29T18:00:00Z", 7), ("CCTMS", "2026-11-29T18:00:00Z"),
     ("CCTMS", "9999-12-31T23:59:59Z", 0), ("CCCLK", 2026, 13, 1, 0, 0, 0), ("CCCLK", 9999, 12, 31, 23, 59, 60),
     ("CCCLK", 2026, 1, 1), ("CCCLK", 2026, 1, 1, 0, 0, 10**12)],
)  # fmt: skip
def test_a_date_that_cannot_be_is_refused(program: Program, said: tuple[Any, ...]) -> None:
    program.says(*said)
    assert program.hears()[0] == "CAERR"
    program.says("CCCLQ")
    assert program.hears()[:2] == ["CACLK", "2026"]


def test_a_modem_that_is_sent_to_sleep_begins_anew(program: Program) -> None:
    program.says("CCCYC", 0, 1, 2, 1, 1, 2)
    assert [program.hears()[0] for _ in range(2)] == ["CACYC", "CADRQ"]
    program.says("CCMSC", 1, 1, 0)
    assert program.hears() == ["CAMSC", "1", "1", "0"]
    assert [program.hears()[2] for _ in range(2)] == ["INIT", "AUV"]
    program.says("CCTXD", 1, 2, 0, "00")
    assert program.hears()[-1] == "NO DATA WERE ASKED FOR"
    program.says("CCMSC", 1, 2, 0)
    assert program.hears()[-1] == "NO MODEM IS SENT TO SLEEP BY SOUND"


def test_rate_0_holds_32_bytes_and_has_statistics_of_its_cycle(program: Program, water: Water) -> None:
    """The cycle begins with a packet of its own, so Goby3 waits for two statistics, at both ends."""
    program.says("CCCYC", 0, 1, 2, 0, 0, 1)
    assert program.hears()[0] == "CACYC"
    assert program.hears()[5] == "32"
    program.says("CCTXD", 1, 2, 0, "AB" * 32)
    assert program.hears()[0] == "CATXD" and len(water.sends().payload) == 32
    assert [program.hears()[0] for _ in range(4)] == ["CATXP", "CATXF", "CAXST", "CAXST"]
    water.brings(2, b"\xaa" * 32, head=bytes((9, 0, 0, 1, 1)), what=FRAME, left=3.0, came=3.5)
    told = [program.hears() for _ in range(5)]
    assert [one[0] for one in told] == ["CACYC", "CACST", "CARXP", "CARXD", "CACST"]
    assert told[3][5] == "AA" * 32


def test_data_that_do_not_come_are_told_in_the_statistics(
    program: Program, water: Water, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.addons.modems.micromodem.DATA_TIMEOUT_S", 0.0)
    program.says("CCCYC", 0, 1, 2, 1, 1, 2)
    told = [program.hears() for _ in range(4)]
    assert [one[0] for one in told] == ["CACYC", "CADRQ", "CAERR", "CAXST"]
    assert told[2][2:] == ["DATA_TIMEOUT", "1"] and told[3][5] == "4" and not water.given


def test_the_driver_of_goby3_starts(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """What its `startup` and `set_clock` send, and what they wait for: a sentence of the same kind, for CCCFG with the
    same words, and for the clock with a date that is right within a second."""
    monkeypatch.setattr(ModemClock, "wait_s", staticmethod(lambda: 0.0))
    for name, value in (("CST", 1), ("SRC", 1), ("REV", 1), ("RXP", 1)):
        program.says("CCCFG", name, value)
        assert program.hears() == ["CACFG", name, str(value)]
    program.says("CCMSC", 1, 1, 0)
    revision = [program.hears() for _ in range(3)][2][3]
    assert int(revision.split(".")[0]) >= 2 and len(revision.split(".")) == 3  # so it sets the clock by CCTMS
    program.says("CCTMS", "2031-02-03T04:05:06Z", 0)
    kind, timed_out, date = program.hears()
    assert (kind, timed_out, date) == ("CATMS", "0", "2031-02-03T04:05:06Z")
    program.says("CCCFQ", "TOP")
    assert all(program.hears()[0] == "CACFG" for _ in DEFAULTS)
    program.says("CCTMQ", 0)
    assert program.hears()[1].startswith("2031-02-03T04:05:")


def test_a_mini_packet(program: Program, water: Water) -> None:
    program.says("CCMUC", 1, 2, "1ABC")
    assert program.hears() == ["CAMUC", "1", "2", "1ABC"]
    request = water.sends()
    assert (request.to, request.what, request.payload) == (2, MINI, b"\x1a\xbc")
    assert [program.hears()[0] for _ in range(3)] == ["CATXP", "CATXF", "CAXST"]
    water.brings(2, b"\x0f\x00", what=MINI, left=1.0, came=1.1)
    assert program.hears() == ["CAMUA", "2", "1", "0F00"]
    assert program.hears()[:3] == ["CACST", "6", "0"]


def test_a_ping_has_the_one_way_time(program: Program, water: Water) -> None:
    program.says("CCMPC", 1, 2)
    assert program.hears() == ["CAMPC", "1", "2"]
    water.sends(at_s=1.0)
    answer = b"\0" + round(1.4e9).to_bytes(8, "little")
    water.brings(2, answer, what=RANGING, left=4.4, came=4.8)
    assert program.hears() == ["CAMPR", "2", "1", "0.4000"]
    assert program.hears()[:3] == ["CACST", "6", "0"]


def test_a_ping_of_another_one_is_told(program: Program, water: Water) -> None:
    water.brings(3, b"\7", what=RANGING, left=1.0, came=2.0)
    assert program.hears() == ["CAMPA", "3", "1"] and program.hears()[0] == "CACST"
    assert water.next().to == 3


def test_a_cycle_of_two_frames_is_acknowledged(program: Program, water: Water) -> None:
    program.says("CCCYC", 0, 1, 2, 1, 1, 2)
    assert program.hears() == ["CACYC", "0", "1", "2", "1", "1", "2"]
    for number, data in ((1, "AA"), (2, "BBCC")):
        kind, _, *rest = program.hears()
        assert (kind, rest) == ("CADRQ", ["1", "2", "1", "64", str(number)])
        program.says("CCTXD", 1, 2, 1, data)
        assert program.hears() == ["CATXD", "1", "2", "1", str(len(data) // 2)]
    first, second = water.sends(), water.sends()
    assert (first.head, first.payload) == (bytes((1, 1, 1, 1, 2)), b"\xaa")
    assert (second.head, second.payload) == (bytes((1, 1, 1, 2, 2)), b"\xbb\xcc")
    assert [program.hears() for _ in range(2)] == [["CATXP", "3"], ["CATXF", "3"]]
    kind, version, *rest = program.hears()
    assert (kind, version, rest[2:4], rest[7:]) == ("CAXST", "6", ["0", "0"], ["1", "1", "2", "1", "2", "2", "0", "3"])
    water.brings(2, b"\x03", what=ANSWER, left=5.0, came=5.5)
    assert [program.hears() for _ in range(2)] == [["CAACK", "2", "1", "1", "1"], ["CAACK", "2", "1", "2", "1"]]
    assert program.hears()[:3] == ["CACST", "6", "0"]  # Goby3 hands on what was received when it comes


def test_a_packet_that_comes(program: Program, water: Water) -> None:
    for number, data in ((1, b"\xaa"), (2, b"\xbb")):
        head = bytes((9, 1, 1, number, 2))
        water.brings(2, data, head=head, what=FRAME, left=float(number), came=number + 0.5)
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
    water.core.on_spoiled(Cause.COLLISION, water.at(3.0))
    assert program.hears() == ["CAMSG", "BAD_CRC", "1"]
    kind, _, mode, *rest = program.hears()
    assert (kind, mode, rest[16:18]) == ("CACST", "1", ["1", "1"])


def test_a_packet_of_the_second_generation(program: Program, water: Water) -> None:
    program.says("CCTDP", 2, 1, 0, 0, "DEADBEEF")
    assert program.hears()[:5] == ["CATDP", "0", "1", "2", "1"]
    request = water.sends()
    assert (request.head, request.payload) == (bytes((1, 1, 2, 1, 1)), bytes.fromhex("DEADBEEF"))
    assert [program.hears()[0] for _ in range(3)] == ["CATXP", "CATXF", "CAXST"]
    water.brings(2, b"\x01\x02", head=bytes((1, 1, 2, 1, 1)), what=FRAME, left=1.0, came=1.5)
    assert program.hears() == ["CARDP", "2", "1", "1", "0", "0", "1;2;0102", ""]


def test_a_full_queue_holds_up_no_acknowledgement(program: Program, water: Water) -> None:
    """Two mini packets wait, and one is in the channel."""
    for _ in range(3):
        program.says("CCMUC", 1, 2, "1ABC")
        assert program.hears()[0] == "CAMUC"
    water.brings(2, b"A", head=bytes((9, 1, 1, 1, 1)), what=FRAME, left=1.0, came=1.5)
    assert [water.sends().what for _ in range(4)] == [MINI, MINI, MINI, ANSWER] and not water.core.remark


@pytest.mark.parametrize("head", [(9, 1, 1, 0, 1), (9, 1, 1, 2, 1), (9, 1, 1, 1, 9), (9, 1, 1, 1, 0), (9, 1, 1)])
def test_a_head_that_no_modem_has_is_no_frame(program: Program, water: Water, head: tuple[int, ...]) -> None:
    water.brings(2, b"A", head=bytes(head), what=FRAME, left=1.0, came=1.5)
    program.says("CCCFQ", "SRC")
    assert program.hears()[0] == "CACFG" and not water.core.remark


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


def test_frames_of_two_packets_make_no_packet(program: Program, water: Water) -> None:
    """The second frame of the first one and the first frame of the second one were lost."""
    water.brings(2, b"A", head=bytes((9, 1, 2, 1, 2)), what=FRAME, left=1.0, came=1.5)
    water.brings(2, b"B", head=bytes((10, 1, 2, 2, 2)), what=FRAME, left=2.0, came=2.5)
    water.brings(2, b"C", head=bytes((11, 1, 2, 1, 1)), what=FRAME, left=3.0, came=3.5)
    told = [line[-2] for line in (program.hears() for _ in range(6)) if line[0] == "CARDP"]
    assert told == ["1;1;41;0;0;", "0;0;;1;1;42", "1;1;43"]


def test_a_packet_that_finds_no_room_is_refused_whole(program: Program, water: Water) -> None:
    """Two wait, and one is in the channel: a packet of four frames has no room."""
    program.says("CCTDP", 2, 5, 0, 0, "00" * 4 * 64)
    assert program.hears()[0] == "CATDP" and program.hears()[-1] == "THE QUEUE IS FULL"
    assert not water.given and water.core.remark.startswith("its modem refused 4 payloads")
    program.says("CCTDP", 2, 5, 0, 0, "00" * 3 * 64)
    water.core.on_dropped(water.next().tag, Cause.MUTE)
    for _ in range(2):
        water.sends()
    assert [program.hears()[0] for _ in range(4)] == ["CATDP", "CAERR", "CATXP", "CATXF"]


def test_a_terminal_stays_for_the_next_program(tmp_path: Path) -> None:
    """One has said a line without an end, and read nothing of what it was told."""
    path = tmp_path / "ttyAUV"
    water = Water(MicroModem, core=ModemCore(1, MicroModem, terminal=str(path)))
    (terminal,) = water.core.line_port.clients
    with open(path, "r+b", buffering=0) as bad:
        for _ in range(MOST_LINE // 1024 + 2):
            os.write(bad.fileno(), b"7" * 1024)
        os.write(bad.fileno(), b"\n")

        def is_full() -> bool:
            for _ in range(100):
                water.brings(2, b"\x0f\x00", what=MINI, left=1.0, came=1.1)
            return len(terminal.waiting) > MOST_UNREAD

        wait_for(is_full, LIMIT_S, "what nobody reads")
        assert len(terminal.waiting) < 2 * MOST_UNREAD
    with open(path, "r+b", buffering=0) as good:
        os.write(good.fileno(), sentence("CCCFG", "TXP", 3))
        said = b""
        while b"CACFG,TXP,3" not in said:
            said = said[-100:] + os.read(good.fileno(), 1 << 16)
            os.write(good.fileno(), sentence("CCCFG", "TXP", 3))
    water.core.close()


def test_the_terminal_of_a_run_that_was_killed_is_made_anew(tmp_path: Path) -> None:
    """Its number may be that of the new one."""
    path = tmp_path / "ttyAUV"
    ours, theirs = os.openpty()
    path.symlink_to(os.ttyname(theirs))
    os.close(ours)
    os.close(theirs)
    water = Water(MicroModem, core=ModemCore(1, MicroModem, terminal=str(path)))
    assert path.exists()
    water.core.close()


def test_a_link_of_somebody_else_stays(tmp_path: Path) -> None:
    """The lock of a browser is a link to nothing; and what takes the place of ours later is not ours either."""
    lock = tmp_path / "SingletonLock"
    lock.symlink_to("host-4711")
    with pytest.raises(BusError, match="something is there"):
        ModemCore(1, MicroModem, terminal=str(lock)).listen()
    assert lock.is_symlink()
    path = tmp_path / "ttyAUV"
    water = Water(MicroModem, core=ModemCore(1, MicroModem, terminal=str(path)))
    path.unlink()
    path.symlink_to("host-4712")
    water.core.close()
    assert path.is_symlink()
