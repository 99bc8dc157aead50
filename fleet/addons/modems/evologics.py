"""The language of EvoLogics S2C modems: AT commands over TCP. Experimental: no client of the maker was tried with it.

Written from what public drivers send and take, independent of each other: evins of EvoLogics' own people (Erlang,
github.com/okebkal/evins, role_at.erl), usbl_evologics of Rock, DUNE (github.com/LSTS/dune, Transports/Evologics), and
those of signetlabdei, oceansystemslab and GSO-soslab on GitHub. In the data mode commands and answers stand behind
`+++`, and everything else is data for the remote address, byte by byte. In the command mode there are commands alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from fleet.addons.modems.delivery import CLEARED, UNANSWERED, Job
from fleet.addons.modems.evologics_settings import OK, VERSIONS, Settings
from fleet.addons.modems.fragments import MOST_PIECES, PayloadPieces
from fleet.addons.modems.line_port import MOST_LINE, Client
from fleet.addons.modems.modem import FIRST_OWN, FULL, PIGGYBACK, ModemCore
from fleet.addons.modems.usbl import UsblFix, measure_fix
from netem.cause import Cause
from netem.endpoint import EVERYBODY, HeardFrame, Level, SentFrame, Sound

Mode = Literal["data", "command"]
BROADCAST = 255
MOST_MESSAGE = 64  # bytes of an instant message
# Protocol numbers: instant messages, burst data, what is acknowledged, and messages with a time.
INSTANT, BURST, _LINK, TIMED = FIRST_OWN + 2, FIRST_OWN + 3, FIRST_OWN + 4, FIRST_OWN + 8
_SEND = re.compile(
    rb"AT\*SEND(?:(IM),(?:p(\d),)?(\d{1,4}),(\d{1,3}),(ack|noack|force)"
    rb"|(IMS),(?:p(\d),)?(\d{1,4}),(\d{1,3}),(\d{0,18})"
    rb"|(PBM|),(?:p(\d),)?(\d{1,4}),(\d{1,3})),",
    re.ASCII,
)
_PLAIN = re.compile(rb"AT([?!@&]?[A-Z]{1,5}|\*?[A-Z]+)(\d{0,6})", re.ASCII)
_SENDS = re.compile(rb"AT(\*SEND[A-Z]*)", re.ASCII)
_COMMAND = b"+++AT"
_ESCAPE = b"+++"
BAD, NOT_HERE, RANGE, BUSY = b"ERROR WRONG FORMAT", b"ERROR UNKNOWN COMMAND", b"ERROR OUT OF RANGE", b"BUSY DELIVERING"
LISTENS = b"INITIATION LISTEN"  # DUNE, evins and Rock wait for it; that it never changes is an assumption
_PASSES = (FULL, UNANSWERED)  # the reasons that are gone later
PAUSE_S = 0.05  # bytes of the data mode without a line feed are sent after it
ESCAPE_S = 1.0  # around `+++`, as Rock's Driver.cpp waits before and behind it
# Rock's test has an RSSI of -54 dB from 14 m: of 184 dB re 1 uPa at 1 m, the level of `s2c`, 167 dB arrive there.
RSSI_0 = 221.0  # dB re 1 uPa: an assumption, from that
# A driver on GitHub quotes the manual: above 100 a message is valid. So a signal at the limit has 100. That the number
# grows by 2 with each decibel is an assumption.
_LIMIT, _PER_DB = 100, 2.0


@dataclass(slots=True)
class _Talk:
    """How one program talks."""

    data: bool  # whether it is in the data mode
    before: bytes = b""  # the beginning of a command with line feeds in its data
    pids: bool = False  # whether it names protocol numbers, and so is told them


class EvoLogics:
    """One modem."""

    delimiter = b"\n"
    link: int | None = _LINK

    def __init__(self, mode: Mode = "data", usbl: float | None = None) -> None:
        """Begin.

        Args:
            mode: in which a connection begins.
            usbl: standard deviation of its bearings and elevations [rad]; None: it measures none.
        """
        self._mode, self._usbl = mode, usbl
        self._settings = Settings()
        self._waiting = 0  # messages without their acknowledgement
        self._last_failed = False  # whether the last one of them has failed
        self._delivered = self._fixes = 0
        self._stream = b""  # of the data mode, not given to the modem yet
        self._fragments, self._clears = PayloadPieces(), 0

    def begin(self, modem: ModemCore) -> None:
        """See `ModemLanguage`."""
        self._modem = modem

    def on_opened(self, client: Client) -> None:
        """See `Translator`."""
        client.state = _Talk(self._mode == "data")

    def on_closed(self, client: Client) -> None:
        """See `Translator`."""

    def on_line(self, client: Client, line: bytes) -> None:
        """See `Translator`."""
        talk: _Talk = client.state
        whole = talk.before + b"\n" + line if talk.before else line
        if talk.data and not talk.before:
            data, found, rest = whole.partition(_COMMAND)
            if not found and not whole.startswith(_ESCAPE):
                self._take_data(client, whole + b"\n")
                return
            if found:
                self._take_data(client, data)
                whole = found + rest
        talk.before = b""
        command = whole.removeprefix(_ESCAPE)
        if found_send := _SEND.match(command):
            self._send(client, found_send, command[found_send.end() :], whole)
        elif known := _SENDS.match(command):
            self._answer(client, known[1], BAD)
        else:
            self._plain(client, command.strip(), escaped=whole.startswith(_ESCAPE))

    def on_partial(self, client: Client) -> None:
        """See `Translator`. Bytes of the data mode need no line feed: they leave after a pause."""
        said, talk = client.unfinished, client.state
        if not talk.data or talk.before:
            return

        def quiet() -> None:
            if client.unfinished is not said or client not in self._modem.line_port.clients or not talk.data:
                return
            if said == _ESCAPE:
                client.unfinished = b""
                self._plain(client, b"", escaped=True)
            elif not _ESCAPE.startswith(said[:3]):
                data, found, rest = said.partition(_COMMAND)
                client.unfinished = found + rest
                self._take_data(client, data)

        self._modem.call_after(ESCAPE_S if said == _ESCAPE else PAUSE_S, quiet)

    def _answer(self, client: Client, command: bytes, said: bytes) -> None:
        """Answer a command, as the mode wants it."""
        self._modem.line_port.say(client, _frame(command, said) if client.state.data else said + b"\r\n")

    def _tell(self, said: bytes | Callable[[_Talk], bytes], switch: bytes = b"") -> None:
        """Tell all clients something that nobody asked for. `switch`: the one that it needs."""
        if switch and not self._settings.switches[switch]:
            return
        for client in list(self._modem.line_port.clients):
            self._answer(client, b"", said if isinstance(said, bytes) else said(client.state))

    def _plain(self, client: Client, command: bytes, *, escaped: bool) -> None:
        found = _PLAIN.fullmatch(command)
        if command == b"" and escaped:  # the escape of the data mode
            client.state.data = False
            self._answer(client, b"", OK)
            return
        if found is None:
            self._answer(client, b"", BAD)
            return
        name, value = found[1], int(found[2]) if found[2] else None
        match name:
            case b"C":
                self._answer(client, name, OK)
                client.state.data = False
            case b"O":
                client.state.data = True
            case b"Z":
                self._stream = b""
                self._clears += 1
                self._modem.clear()
                if value != 0:  # of the device itself there is no answer, as Rock's driver knows
                    self._answer(client, name, OK)
            case b"A" | b"?S":
                self._answer(client, name, LISTENS)
            case b"H":  # there are no connections that could be closed
                self._answer(client, name, OK)
            case b"I":
                self._answer(client, name, VERSIONS.get(b"I%d" % (value or 0), NOT_HERE))
            case b"?DI":  # Rock knows these words
                waits = b"FAILED" if self._last_failed else b"EMPTY"
                self._answer(client, name, b"DELIVERING" if self._waiting else waits)
            case _:
                said = self._settings.take(self._modem, name, value)
                self._answer(client, name, NOT_HERE if said is None else said)

    def _send(self, client: Client, found: re.Match[bytes], data: bytes, whole: bytes) -> None:
        kind, pid, length, to, more = next(
            (found[n] or b"", found[n + 1], int(found[n + 2]), int(found[n + 3]), found[n + 4] if n < 10 else b"")
            for n in (1, 6, 11)
            if found[n] is not None
        )
        name = b"*SEND" + kind
        data = data[:-1] if len(data) == length + 1 and data.endswith(b"\r") else data
        if len(data) < length:  # a line feed was a part of the message
            client.state.before = whole
            return
        if len(data) > length or (kind and length > MOST_MESSAGE):
            self._answer(client, name, BAD)
            return
        client.state.pids |= pid is not None
        number = self._settings.numbers[b"ZS"] if pid is None else int(pid)
        if kind == b"IMS":
            said = self._submit_timed(to, data, number, int(more) if more else None)
        elif kind == b"PBM":
            said = RANGE if self._modem.answer_with(to, data) else OK
        else:
            said = self._submit(to, data, number, instant=kind == b"IM", answered=more != b"noack")
        self._answer(client, name, said)

    def _take_data(self, client: Client, data: bytes) -> None:
        if not data:
            return
        if not self._settings.numbers[b"AR"]:
            hint = "commands begin with +++ there, or the key mode: command is what the program wants"
            self._modem.remark_once(
                f"its program said something else than +++AT in the data mode, without AT!AR; {hint}"
            )
            return
        self._stream += data
        self._go_on()
        if len(self._stream) > MOST_LINE:
            self._stream = b""
            self._modem.line_port.end(client)

    def _go_on(self) -> None:
        """Give the modem what it takes of the data."""
        to, most = self._settings.numbers[b"AR"], max(1, self._modem.channel.mtu)
        while to and self._stream and self._modem.room > 0:
            piece = self._stream[:most]
            if self._submit(to, piece, self._settings.numbers[b"ZS"], instant=False, answered=True) != OK:
                return
            self._stream = self._stream[len(piece) :]

    def _submit(self, to: int, data: bytes, pid: int, *, instant: bool, answered: bool) -> bytes:
        """Send a message. Returns the answer to its command."""
        address, word = EVERYBODY if to == BROADCAST else to, b"IM" if instant else b""

        def ends(answer: HeardFrame | None) -> None:
            self._waiting -= 1
            self._last_failed = answer is None
            self._delivered += not instant and answer is not None
            count = b"" if instant else b"%d," % self._delivered
            self._tell(b"%b%b,%b%d" % (b"FAILED" if answer is None else b"DELIVERED", word, count, to))
            if answer is not None:
                self._tell_place(answer)
            self._go_on()

        def dropped(_: str) -> None:
            self._tell(b"CANCELED%b,%d" % (word, to))

        answered &= address != EVERYBODY
        told, what = self._told(to, b"im" if instant else b"burst"), INSTANT if instant else BURST
        if not instant and len(data) > MOST_PIECES * self._modem.channel.mtu:
            return RANGE
        # Burst data may be longer than a frame; they are sent piece by piece.
        pieces = [(b"", data)] if instant else self._fragments.split(data, max(1, self._modem.channel.mtu))
        turn = self._clears

        def send(number: int) -> str:
            head, piece = pieces[number]
            job = Job(piece, address, what, partial(sent, number), dropped, bytes((pid,)) + head)
            if answered:
                return self._modem.deliver(job, 1, partial(ended, number), goes_on=number > 0)
            return self._modem.go_on(job) if number else self._modem.submit(job)

        def sent(number: int, frame: SentFrame) -> None:
            told(frame)
            if not answered and number + 1 < len(pieces) and self._clears == turn:
                send(number + 1)

        def ended(number: int, answer: HeardFrame | None) -> None:
            if answer is None or number + 1 == len(pieces):
                ends(answer)
            elif send(number + 1):
                ends(None)

        if why := send(0):
            return BUSY if why in _PASSES else RANGE
        self._waiting += answered
        return OK

    def _submit_timed(self, to: int, data: bytes, pid: int, at_us: int | None) -> bytes:
        """Send a synchronous message at a time of the modem's clock [us]; None: when it is its turn."""

        def dropped(reason: str) -> None:
            self._tell(b"%bIMS,%d" % (b"CANCELED" if reason == CLEARED else b"EXPIRED", to))

        job = Job(data, EVERYBODY if to == BROADCAST else to, TIMED, self._told(to, b"ims"), dropped)
        job.head = bytes((pid,))
        modem = self._modem
        if why := modem.submit(job) if at_us is None else modem.submit_at(job, modem.at_ns(at_us)):
            return BUSY if why in _PASSES else RANGE
        return OK

    def _told(self, to: int, kind: bytes) -> Callable[[SentFrame], None]:
        """What tells that a message begins to be transmitted, and has ended."""

        def sent(frame: SentFrame) -> None:
            self._tell(b"SENDSTART,%d,%b,%d,0" % (to, kind, frame.airtime_ns // 1000), b"ZX")
            end_us = self._modem.us(frame.at_ns + frame.airtime_ns)
            said = b"SENDEND,%d,%b,%d,%d" % (to, kind, end_us, frame.airtime_ns // 1000)
            self._modem.call_after(frame.airtime_ns / 1e9, lambda: self._tell(said, b"ZX"))
            self._go_on()

        return sent

    def on_pinged(self, frame: HeardFrame) -> None:
        """See `ModemLanguage`. Its language has no word for it."""

    def begins(self, sound: Sound) -> None:
        """See `ModemLanguage`."""
        self._tell(b"RECVSTART", b"ZX")

    def on_heard(self, frame: HeardFrame, *, linked: bool) -> None:
        """See `ModemLanguage`."""
        modem, to = self._modem, frame.to or BROADCAST
        if (data := self._fragments.join(frame._replace(head=frame.head[1:]))) is None:
            return  # pieces are missing
        frame = frame._replace(payload=data)
        duration_us = modem.channel.modem.airtime_ns(len(data)) // 1000
        level = b"%d,%d" % self._strength(frame.level)
        self._tell(b"RECVEND,%d,%d,%b" % (modem.us(frame.end_ns), duration_us, level), b"ZX")
        if frame.what == BURST:
            rate = round(8e6 * len(data) / max(1, duration_us))
            head = b"%d,%d,%d,%b,%d,0.0000," % (frame.src, to, rate, level, modem.travel_us)
            for client in list(modem.line_port.clients):
                if client.state.data:  # byte by byte, as it was sent
                    modem.line_port.say(client, data)
                else:
                    self._answer(client, b"", self._message(client.state, b"RECV", frame, head))
            self._tell_direction(frame)
            return
        kind, more = {
            INSTANT: (b"RECVIM", b"ack," if linked else b"noack,"),
            TIMED: (b"RECVIMS", b"%d," % modem.us(frame.begin_ns)),
            PIGGYBACK: (b"RECVPBM", b""),
        }.get(frame.what, (b"", b""))
        if kind:
            head = b"%d,%d,%b%d,%b,0.0000," % (frame.src, to, more, duration_us, level)
            self._tell(lambda talk: self._message(talk, kind, frame, head))
            self._tell_direction(frame)

    def _message(self, talk: _Talk, kind: bytes, frame: HeardFrame, head: bytes) -> bytes:
        """A message that was received. Its protocol number is for programs that name such numbers: evins takes both."""
        named = talk.pids or self._settings.switches[b"ZF"]
        pid = b"p%d," % (frame.head[0] if frame.head else 0) if named else b""
        return b"%b,%b%d,%b%b" % (kind, pid, len(frame.payload), head, frame.payload)

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """See `ModemLanguage`."""
        rssi, integrity = self._strength(level)
        self._tell(b"RECVFAILED,0.0000,%d,%d" % (rssi, min(_LIMIT - 1, integrity)), b"ZX")

    def _strength(self, level: Level) -> tuple[int, int]:
        """The signal strength [dB] and the integrity of what was received."""
        over_db = level.snr - self._modem.channel.modem.clear_above
        return round(level.received - RSSI_0), max(0, round(_LIMIT + _PER_DB * over_db))

    def _tell_place(self, frame: HeardFrame) -> None:
        """USBLLONG, after an acknowledgement: then the travel time is known, and so the range."""
        if self._usbl is None or frame.away is None:
            return
        fix, (now, then) = self._fix(frame), self._times(frame)
        enu, travel_us = fix.enu, (frame.begin_ns - frame.sent_ns) // 1000
        level = self._strength(frame.level)
        # The device's own axes are east, north and up, since it has no attitude here.
        axes = b",".join(b"%.4f" % value for value in (*enu, *enu, 0.0, 0.0, 0.0))
        accuracy = fix.range_m * self._usbl
        said = (now, then, frame.src, axes, travel_us, *level, accuracy)
        self._tell(b"USBLLONG,%.6f,%.6f,%d,%b,%d,%d,%d,%.4f" % said, b"ZU")

    def _tell_direction(self, frame: HeardFrame) -> None:
        """USBLANGLES, after everything else that was received. Angles are in rad, the bearing from north, clockwise."""
        if self._usbl is None or frame.away is None:
            return
        fix, (now, then) = self._fix(frame), self._times(frame)
        both = (fix.bearing, fix.elevation)
        angles = b",".join(b"%.4f" % value for value in (*both, *both, 0.0, 0.0, 0.0))
        said = (now, then, frame.src, angles, *self._strength(frame.level), self._usbl)
        self._tell(b"USBLANGLES,%.6f,%.6f,%d,%b,%d,%d,%.4f" % said, b"ZU")

    def _times(self, frame: HeardFrame) -> tuple[float, float]:
        """Now, and when the measurement was made, by the modem's clock [s]."""
        return self._modem.now_us / 1e6, self._modem.us(frame.begin_ns) / 1e6

    def _fix(self, frame: HeardFrame) -> UsblFix:
        assert frame.away is not None and self._usbl is not None
        self._fixes += 1
        modem = self._modem
        travelled_m = self._settings.speed(modem) * (frame.begin_ns - frame.sent_ns) / 1e9
        key = (modem.number, frame.src, self._fixes)
        return measure_fix(frame.away, travelled_m, self._usbl, modem.channel.seed, key)


def _frame(command: bytes, said: bytes) -> bytes:
    """An answer in the data mode: its command, its length, and itself."""
    return b"+++AT%b:%d:%b\r\n" % (command, len(said), said)
