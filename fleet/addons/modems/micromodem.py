"""The language of the WHOI Micro-Modem: sentences of NMEA 0183 on a serial line or TCP, of both generations.

Written from "Micro-Modem Software Interface Guide" (WHOI, acomms.whoi.edu), and from what two drivers send and take:
WHOI's own client (acomms 3.1 of PyPI) and Goby3's (src/acomms/modemdriver/mm_driver.cpp). What is answered, and what
is not, is in docs/guide/modems.md.

The frames of a packet are sent one by one, and a lost one is a bad frame of the packet. What the modem says beside the
data of a frame is its head: number of the packet, rate, flags, its own number, how many.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import reduce
from time import monotonic_ns
from typing import NamedTuple

from fleet.addons.modems.delivery import Job
from fleet.addons.modems.line_port import Client
from fleet.addons.modems.micromodem_clock import ModemClock
from fleet.addons.modems.modem import FIRST_OWN, ModemCore
from fleet.errors import FleetError
from netem.cause import Cause
from netem.endpoint import EVERYBODY, HeardFrame, Level, SentFrame, Sound

BROADCAST = 127
_MOST_SENTENCE = 2048  # bytes
MINI, FRAME, ANSWER = (
    FIRST_OWN + 5,
    FIRST_OWN + 6,
    FIRST_OWN + 7,
)  # protocol numbers: mini packets, frames of packets, acknowledgements
_HEAD = 5  # bytes
_MOST_FRAMES = 8  # of a packet
_WANTS_ANSWER, _SECOND = 1, 2  # flags: acknowledged; a packet of the second generation (TDP)
DATA_TIMEOUT_S = 2.0  # for the data of a frame that was asked for
_LATE_S = 1.0  # after the last frame could have come, a packet with missing ones is told


class Rate(NamedTuple):
    """The frames of a packet."""

    frames: int
    size: int  # bytes of each


RATES = {0: Rate(1, 32), 1: Rate(3, 64), 2: Rate(3, 64), 3: Rate(2, 256), 4: Rate(2, 256), 5: Rate(8, 256),
         6: Rate(6, 32)}  # fmt: skip
SECOND_RATES = {1: Rate(3, 64), 3: Rate(2, 256), 5: Rate(8, 256)}  # of the second generation
# Parameters before a program has set any. That those of messages are on is an assumption.
DEFAULTS = {
    "SRC": "0", "DBG": "0", "ASD": "0", "PCM": "0", "AGN": "0", "TXP": "1", "TXF": "1", "IRE": "0", "CST": "1",
    "XST": "1", "SNR": "0", "REV": "1", "DTO": "0", "PTO": "0", "TOA": "0", "RXP": "1", "RXD": "1",
}  # fmt: skip
_NAME = re.compile(r"[A-Za-z0-9_.]{1,32}", re.ASCII)  # of three letters, or with dots (second generation)
_MOST_NAMES = 256
_YEARS = range(1970, 2100)
_FIRMWARE = "3.0.0"
_REBOOTED = ("INIT", "uuv-fleet"), ("AUV", _FIRMWARE)


def checksum(text: str) -> str:
    """The checksum of a sentence: the exclusive or of its characters."""
    return f"{reduce(lambda before, each: before ^ each, text.encode(), 0):02X}"


def sentence(kind: str, *values: object) -> bytes:
    """A sentence with its checksum."""
    text = ",".join([kind, *map(str, values)])
    return f"${text}*{checksum(text)}\r\n".encode()


class WrongSentenceError(FleetError):
    """A sentence that cannot be obeyed: the number of the error, and its words."""

    def __init__(self, number: int, words: str) -> None:
        super().__init__(words)
        self.number, self.words = number, words


@dataclass(slots=True)
class _Packet:
    """A packet that leaves."""

    to: int
    rate: int
    answered: bool
    count: int
    frames: list[bytes] = field(default_factory=list)
    asked: int = 0  # data of so many frames were asked for


@dataclass(slots=True)
class _Coming:
    """A packet that comes."""

    packet: int
    rate: int
    flags: int
    count: int
    frames: dict[int, bytes] = field(default_factory=dict)


class MicroModem:
    """One modem."""

    delimiter = b"\n"
    link: int | None = None  # it acknowledges packets of several frames in its own way

    def __init__(self) -> None:
        self._config = dict(DEFAULTS)
        self._packet: _Packet | None = None
        self._coming: dict[int, _Coming] = {}  # by sender
        self._count = self._packets = 0

    def begin(self, modem: ModemCore) -> None:
        """See `ModemLanguage`."""
        self._modem, self._date = modem, ModemClock(modem.channel.begin_ns)
        self._config["SRC"] = str(modem.address)
        for client in modem.line_port.clients:
            self.on_opened(client)

    def on_opened(self, client: Client) -> None:
        """See `Translator`."""
        if hasattr(self, "_modem"):  # a terminal is opened before that
            for what in _REBOOTED:
                self._say_to(client, "CAREV", self._clock(), *what)

    def on_partial(self, client: Client) -> None:
        """See `Translator`."""

    def on_closed(self, client: Client) -> None:
        """See `Translator`."""

    def on_line(self, client: Client, line: bytes) -> None:
        """See `Translator`."""
        text = line[:_MOST_SENTENCE].decode("ascii", "replace").strip()
        if not text:
            return
        body, star, given = text.lstrip("$").partition("*")
        kind, *values = [part.strip() for part in body.split(",")]
        try:
            if not text.startswith("$"):
                raise WrongSentenceError(1, "NMEA sentence expected")
            if star and given.upper() != checksum(body):
                raise WrongSentenceError(2, f"BAD CHECKSUM {given:.8} expected {checksum(body)}")
            handler = _HANDLERS.get(kind)
            if handler is None:
                raise WrongSentenceError(3, f"UNKNOWN COMMAND {kind:.8}")
            handler(self, values)
        except WrongSentenceError as error:
            self._error(error.number, error.words)
        except (ValueError, IndexError, OverflowError):
            self._error(4, f"BAD PARAMETER IN {kind:.8}")

    def _error(self, number: int, words: str) -> None:
        plain = "".join(c if c.isprintable() and c not in "$*," else " " for c in words)
        self._say("CAERR", self._clock(), "NMEA", number, plain)

    def _say(self, kind: str, *values: object) -> None:
        for client in list(self._modem.line_port.clients):
            self._say_to(client, kind, *values)

    def _say_to(self, client: Client, kind: str, *values: object) -> None:
        self._modem.line_port.say(client, sentence(kind, *values))

    def _address(self, text: str) -> int:
        number = int(text)
        if not 1 <= number <= BROADCAST:
            raise WrongSentenceError(6, f"NO ADDRESS {number}")
        return number

    def _configure(self, values: list[str]) -> None:
        name, value = _parameter(values[0]), values[1]
        if name == "ALL":  # as factory-fresh; the address is that of the scenario
            self._config = DEFAULTS | {"SRC": str(self._modem.address)}
            self._say("CACFG", name, value)
            return
        if name in DEFAULTS:
            int(value)
        elif not value or not value.isprintable():
            raise ValueError
        if name == "SRC" and not 1 <= int(value) < BROADCAST:
            raise WrongSentenceError(6, f"NO ADDRESS {value:.16}")
        if name not in self._config and (not _NAME.fullmatch(name) or len(self._config) >= _MOST_NAMES):
            raise WrongSentenceError(7, f"UNKNOWN PARAMETER {name:.16}")
        self._config[name] = value
        self._modem.address = int(self._config["SRC"])
        self._say("CACFG", name, value)  # as it was written: Goby3 compares the texts

    def _query(self, values: list[str]) -> None:
        name = _parameter(values[0])
        if name in ("ALL", "TOP"):
            for each, value in self._config.items():
                self._say("CACFG", each, value)
        elif name.lower() in ("info", "info.firmware_version"):
            self._say("CACFG", "info.firmware_version", _FIRMWARE)
        elif name in self._config:
            self._say("CACFG", name, self._config[name])
        else:
            raise WrongSentenceError(7, f"UNKNOWN PARAMETER {name:.16}")

    def _is_on(self, name: str) -> bool:
        """Whether a parameter lets its messages be said."""
        return int(self._config[name]) != 0

    def _sleep(self, values: list[str]) -> None:
        """CCMSC to itself: it sleeps, and wakes up at once. Goby3 has it begin anew so."""
        src, dst, mode = map(int, values[:3])
        if (src, dst) != (self._modem.address, self._modem.address):
            raise WrongSentenceError(14, "NO MODEM IS SENT TO SLEEP BY SOUND")
        self._packet = None
        self._coming.clear()
        self._say("CAMSC", src, dst, mode)
        if self._is_on("REV"):
            for what in _REBOOTED:
                self._say("CAREV", self._clock(), *what)

    def _level(self, _: list[str]) -> None:
        self._say("CAALQ", 0, 11)

    def _time(self, _: list[str]) -> None:
        now = self._date.now
        self._say("CACLK", now.year, now.month, now.day, now.hour, now.minute, now.second)

    def _tell_time(self, _: list[str]) -> None:
        """CCTMQ: the date, who has set it, and what drives its seconds. The words for these are an assumption."""
        source = "USER_CMD" if self._date.is_set else "NONE"
        self._say("CATMQ", f"{self._date.now:%Y-%m-%dT%H:%M:%SZ}", source, "RTC")

    def _set_time(self, values: list[str]) -> None:
        """CCCLK: year, month, day, hour, minute and second, which may be 60 as the one to come."""
        year, month, day, hour, minute, second = map(int, values[:6])
        date = datetime(year, month, day, hour, minute) + timedelta(seconds=second)
        self._set_date(date, lambda: self._time([]))

    def _set_iso_time(self, values: list[str]) -> None:
        """CCTMS: a date as ISO 8601 has it, and a mode. What drives the seconds is one thing here."""
        date = datetime.fromisoformat(values[0].rstrip("Z"))  # acomms 3.1 writes two of them
        if int(values[1]) not in (0, 1):
            raise ValueError
        self._set_date(date, lambda: self._say("CATMS", 0, f"{self._date.now:%Y-%m-%dT%H:%M:%SZ}"))

    def _set_date(self, date: datetime, then: Callable[[], None]) -> None:
        if date.year not in _YEARS:
            raise WrongSentenceError(15, f"NO YEAR {date.year}")

        def pulse() -> None:
            self._date.set(date)
            then()

        self._modem.call_after(self._date.wait_s(), pulse)

    def _mini(self, values: list[str]) -> None:
        to, data = self._address(values[1]), bytes.fromhex(values[2].zfill(4))
        if len(data) != 2 or int.from_bytes(data) > 0x1FFF:
            raise WrongSentenceError(8, "A MINI PACKET HAS 13 BITS")
        self._transmit(to, MINI, [(b"", data)], 2, self._packet_sent(0, to, answered=False, frames=1, size=2))
        self._say("CAMUC", self._modem.address, to, data.hex().upper())

    def _ping(self, values: list[str]) -> None:
        to = self._address(values[1])

        def measured(range_m: float | None) -> None:
            if range_m is None:
                self._say("CAMSG", "PACKET_TIMEOUT", 0)
            else:
                self._say("CAMPR", to, self._modem.address, f"{range_m / self._modem.channel.sound_speed:.4f}")
                self._statistics(0, 0, to, self._modem.address, 1, 0, monotonic_ns())

        if why := self._modem.range_to(to, measured):
            raise WrongSentenceError(5, why.upper())
        self._say("CAMPC", self._modem.address, to)

    def _cycle(self, values: list[str]) -> None:
        _, src, dst, rate, answered, count = map(int, values[:6])
        if src != self._modem.address:
            raise WrongSentenceError(9, "ONLY DOWNLINKS ARE ANSWERED")
        if rate not in RATES or not 1 <= count <= RATES[rate].frames:
            raise WrongSentenceError(10, f"RATE {rate} HAS NO {count} FRAMES")
        self._packet = _Packet(self._address(str(dst)), rate, bool(answered), count)
        self._say("CACYC", 0, src, dst, rate, answered, count)
        self._ask_for_data()

    def _ask_for_data(self) -> None:
        packet = self._packet
        if packet is None:
            return
        packet.asked += 1
        number = packet.asked
        size = min(RATES[packet.rate].size, self._modem.channel.mtu)
        self._say("CADRQ", self._clock(), self._modem.address, packet.to, int(packet.answered), size, number)

        def late() -> None:
            if self._packet is packet and len(packet.frames) < number:
                self._packet = None
                self._say("CAERR", self._clock(), "DATA_TIMEOUT", number)
                self._packet_sent(packet.rate, packet.to, answered=packet.answered, frames=packet.count, mode=4)()

        self._modem.call_after(DATA_TIMEOUT_S, late)

    def _data(self, values: list[str]) -> None:
        packet, data = self._packet, bytes.fromhex(values[3])
        if packet is None or len(packet.frames) >= packet.asked:
            raise WrongSentenceError(11, "NO DATA WERE ASKED FOR")
        if len(data) > min(RATES[packet.rate].size, self._modem.channel.mtu):
            raise WrongSentenceError(12, f"{len(data)} BYTES ARE TOO MANY FOR A FRAME")
        packet.answered |= bool(int(values[2]))
        packet.frames.append(data)
        self._say("CATXD", self._modem.address, packet.to, int(packet.answered), len(data))
        if len(packet.frames) < packet.count:
            self._ask_for_data()
        else:
            self._packet = None
            self._leave(packet, 0)

    def _second(self, values: list[str]) -> None:
        """CCTDP: a packet of the second generation, with its data in the command."""
        to, rate, answered = self._address(values[0]), int(values[1]), bool(int(values[2]))
        data = bytes.fromhex(values[4])
        if rate not in SECOND_RATES:
            raise WrongSentenceError(10, f"RATE {rate} IS NOT THERE; THERE ARE {' '.join(map(str, SECOND_RATES))}")
        most, size = SECOND_RATES[rate].frames, min(SECOND_RATES[rate].size, self._modem.channel.mtu)
        frames = [data[begin : begin + size] for begin in range(0, len(data), size)] or [b""]
        if len(frames) > most:
            raise WrongSentenceError(12, f"{len(data)} BYTES ARE TOO MANY: {most} FRAMES OF {size}")
        self._count += 1
        self._say("CATDP", 0, self._count, to, rate, int(answered), 0, "", len(data))
        self._leave(_Packet(to, rate, answered, len(frames), frames), _SECOND)

    def _leave(self, packet: _Packet, flags: int) -> None:
        flags |= _WANTS_ANSWER * packet.answered
        total = sum(map(len, packet.frames))

        self._packets = (self._packets + 1) % 256
        heads = (bytes((self._packets, packet.rate, flags, n, packet.count)) for n in range(1, packet.count + 1))
        told = self._packet_sent(
            packet.rate, packet.to, answered=packet.answered, frames=packet.count, size=total, cycle=not flags & _SECOND
        )
        self._transmit(packet.to, FRAME, list(zip(heads, packet.frames, strict=True)), total, told)

    def _packet_sent(
        self, rate: int, to: int, *, answered: bool, frames: int, size: int = 0, mode: int = 0, cycle: bool = False
    ) -> Callable[[], None]:
        """What says CAXST of version 6, twice for a `cycle` at rate 0, which begins with a packet of its own. Its
        fields are those that acomms and Goby3 read. `mode`: 0 it was sent, 4 its data did not come."""

        def say() -> None:
            if not self._is_on("XST"):
                return
            modem, now = self._modem.channel.modem, self._date.now
            date, time = f"{now:%Y%m%d}", f"{now:%H%M%S}.{now.microsecond // 100:04d}"
            head = [6, date, time, int(self._date.is_set), mode, 0, round(modem.bandwidth), round(modem.carrier)]
            whose = [rate, self._modem.address, to, int(answered), frames, 0 if mode else frames, 0, size]
            for _ in range(2 if cycle and rate == 0 and not mode else 1):
                self._say("CAXST", *head, *whose)

        return say

    def _transmit(
        self, to: int, what: int, frames: list[tuple[bytes, bytes]], size: int, told: Callable[[], None]
    ) -> None:
        """Send some payloads with their heads, all or none, and say when the first begins and the last has ended.
        `told` says what there is to say then."""
        left, began = len(frames), False

        def sent(frame: SentFrame) -> None:
            nonlocal began
            if not began:
                began = True
                if self._is_on("TXP"):
                    self._say("CATXP", size)
            ends(frame.airtime_ns / 1e9)

        def dropped(reason: str) -> None:
            self._error(13, f"NOT TRANSMITTED: {reason}")
            ends(0.0)

        def ends(wait_s: float) -> None:
            nonlocal left
            left -= 1
            if began and not left:
                self._modem.call_after(wait_s, over)

        def over() -> None:
            if self._is_on("TXF"):
                self._say("CATXF", size)
            told()

        if why := self._modem.submit(
            *(Job(data, _parse_address(to), what, sent, dropped, head) for head, data in frames)
        ):
            raise WrongSentenceError(5, why.upper())

    def begins(self, sound: Sound) -> None:
        """See `ModemLanguage`. Its language has no word for it."""

    def on_heard(self, frame: HeardFrame, *, linked: bool) -> None:
        """See `ModemLanguage`."""
        to = frame.to or BROADCAST
        if frame.what == MINI:
            self._say("CAMUA", frame.src, to, frame.payload.hex().upper())
            self._received(frame, 0)
        elif frame.what == ANSWER and len(frame.payload) == 1:
            for number in range(1, 9):
                if frame.payload[0] & 1 << (number - 1):
                    self._say("CAACK", frame.src, self._modem.address, number, 1)
            self._received(frame, 0)
        elif frame.what == FRAME and len(frame.head) == _HEAD:
            self._hears_frame(frame, to)

    def _hears_frame(self, frame: HeardFrame, to: int) -> None:
        packet, rate, flags, number, count = frame.head
        if not 1 <= number <= count <= _MOST_FRAMES:
            return  # no frame of ours
        coming = self._coming.get(frame.src)
        if coming is None or coming.packet != packet:
            self._end(frame.src, to, frame.end_ns)
            coming = self._coming[frame.src] = _Coming(packet, rate, flags, count)
            if not flags & _SECOND:
                self._say("CACYC", 1, frame.src, to, rate, flags & _WANTS_ANSWER, count)
                if rate == 0:  # its cycle begins with a packet of its own, and so has statistics of its own
                    self._received(frame, rate)
                if self._is_on("RXP"):
                    self._say("CARXP", 1)
        data = coming.frames[number] = frame.payload
        if not flags & _SECOND and self._is_on("RXD"):
            self._say("CARXD", frame.src, to, flags & _WANTS_ANSWER, number, data.hex().upper())
        if len(coming.frames) == count:
            self._end(frame.src, to, frame.end_ns)
            return
        channel = self._modem.channel
        most_s = (count - number) * (channel.modem.airtime_ns(channel.mtu) / 1e9 + channel.access_s) + _LATE_S

        def late() -> None:
            if self._coming.get(frame.src) is coming:
                self._end(frame.src, to, frame.end_ns)

        self._modem.call_after(most_s, late)

    def _end(self, src: int, to: int, at_ns: int) -> None:
        """A packet is over: tell it, or what is missing of it, and acknowledge what has come."""
        coming = self._coming.pop(src, None)
        if coming is None:
            return
        if coming.flags & _SECOND:
            each = [coming.frames.get(number) for number in range(1, coming.count + 1)]
            told = ";".join(
                f"{int(data is not None)};{len(data or b'')};{(data or b'').hex().upper()}" for data in each
            )
            # acomms reads the last field but one, and Goby3 both.
            self._say("CARDP", src, to, coming.rate, coming.flags & _WANTS_ANSWER, 0, told, "")
        self._statistics(0, coming.rate, src, to, coming.count, coming.count - len(coming.frames), at_ns)
        if coming.flags & _WANTS_ANSWER and to == self._modem.address:
            bits = sum(1 << (number - 1) for number in coming.frames)
            self._modem.go_on(Job(bytes((bits & 255,)), src, ANSWER))

    def on_pinged(self, frame: HeardFrame) -> None:
        """See `ModemLanguage`."""
        self._say("CAMPA", frame.src, self._modem.address)
        self._received(frame, 0)

    def _received(self, frame: HeardFrame, rate: int) -> None:
        """Something of one part has been received. Goby3 hands it on when its statistics come."""
        self._statistics(0, rate, frame.src, frame.to or BROADCAST, 1, 0, frame.end_ns)

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """See `ModemLanguage`."""
        self._say("CAMSG", "BAD_CRC", 1)
        self._statistics(1, 0, 0, self._modem.address, 1, 1, at_ns)

    def _statistics(self, mode: int, rate: int, src: int, dst: int, frames: int, bad: int, at_ns: int) -> None:
        """CACST of version 6: fields that the channel does not know are 0, and the noise -100."""
        if not self._is_on("CST"):
            return
        modem = self._modem.channel.modem
        at = self._date.at(at_ns)
        toa = f"{at:%Y%m%d%H%M%S}.{at.microsecond // 100:04d}"
        known = [rate, src, dst, 0, 0, frames, bad]
        quality = [0, "0.0", "0.0", "0.0", "0.0", 0, "0.0", -100, round(modem.carrier), round(modem.bandwidth)]
        self._say("CACST", 6, mode, toa, int(self._date.is_set), *[0] * 9, *known, *quality)

    def _clock(self) -> str:
        return f"{self._date.now:%H%M%S}"


def _parameter(name: str) -> str:
    """A parameter as it is kept: names of three letters are capitals, as Goby3 and acomms write them."""
    return name.upper() if len(name) == 3 else name


def _parse_address(address: int) -> int:
    return EVERYBODY if address == BROADCAST else address


_HANDLERS: dict[str, Callable[[MicroModem, list[str]], None]] = {
    "CCCFG": MicroModem._configure,
    "CCCFQ": MicroModem._query,
    "CCALQ": MicroModem._level,
    "CCCLQ": MicroModem._time,
    "CCCLK": MicroModem._set_time,
    "CCTMQ": MicroModem._tell_time,
    "CCTMS": MicroModem._set_iso_time,
    "CCMSC": MicroModem._sleep,
    "CCMUC": MicroModem._mini,
    "CCMPC": MicroModem._ping,
    "CCCYC": MicroModem._cycle,
    "CCTXD": MicroModem._data,
    "CCTDP": MicroModem._second,
}
