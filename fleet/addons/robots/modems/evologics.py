"""The language of EvoLogics S2C modems: AT commands over TCP. Experimental: no client of the maker was tried with it.

Written from what two public drivers send and take, independent of each other: evins of EvoLogics' own people (Erlang,
github.com/okebkal/evins, role_at.erl) and drivers-usbl_evologics of Rock (C++, github.com/rock-drivers). Answered are
instant messages, burst data, addresses, the travel time, the source level, and the two modes. In the data mode commands
and answers stand behind `+++`, and everything else is data for the remote address.
"""

from __future__ import annotations

import re

from fleet.addons.robots.modems.delivery import Job
from fleet.addons.robots.modems.line_port import Client
from fleet.addons.robots.modems.modem import FIRST_OWN, ModemCore
from netem.cause import Cause
from netem.endpoint import EVERYBODY, HeardFrame, Level, SentFrame, Sound

BROADCAST = 255
MOST_MESSAGE = 64  # bytes of an instant message
INSTANT, BURST, _LINK = (
    FIRST_OWN + 2,
    FIRST_OWN + 3,
    FIRST_OWN + 4,
)  # protocol numbers: instant messages, burst data, and what is acknowledged
_LEVELS = range(4)  # 0 is the loudest
_SEND = re.compile(rb"AT\*SEND(IM)?,(?:p\d+,)?(\d{1,4}),(\d{1,3}),(?:(ack|noack|force),)?", re.ASCII)
_PLAIN = re.compile(rb"AT([?!]?[A-Z]{1,3}|\*?[A-Z]+)(\d{0,6})", re.ASCII)
OK, BAD, NOT_HERE = b"OK", b"ERROR WRONG FORMAT", b"ERROR UNKNOWN COMMAND"


class EvoLogics:
    """One modem."""

    delimiter = b"\n"
    link: int | None = _LINK

    def __init__(self) -> None:
        self._waiting = 0  # messages without their acknowledgement
        self._remote = 0  # the address of burst data
        self._level = 0
        self._delivered = 0

    def begin(self, modem: ModemCore) -> None:
        """See `ModemLanguage`."""
        self._modem = modem

    def opened(self, client: Client) -> None:
        """See `Translator`. A connection begins in the data mode."""
        client.state = [True, b""]  # whether it is in the data mode; the beginning of a message with line feeds in it

    def closed(self, client: Client) -> None:
        """See `Translator`."""

    def line(self, client: Client, line: bytes) -> None:
        """See `Translator`."""
        in_data_mode, before = client.state
        whole = before + b"\n" + line if before else line
        client.state[1] = b""
        escaped = whole.startswith(b"+++")
        if in_data_mode and not escaped:
            self._burst(client, line.rstrip(b"\r"))
            return
        command = whole.removeprefix(b"+++")
        if found := _SEND.match(command):
            self._send(client, found, command[found.end() :], whole)
        else:
            self._plain(client, command.strip(), escaped=escaped)

    def _answer(self, client: Client, command: bytes, said: bytes) -> None:
        """Answer a command, as the mode wants it."""
        self._modem.line_port.say(client, _framed(command, said) if client.state[0] else said + b"\r\n")

    def _tell(self, said: bytes) -> None:
        """Tell all clients something that nobody asked for."""
        for client in list(self._modem.line_port.clients):
            self._answer(client, b"", said)

    def _plain(self, client: Client, command: bytes, *, escaped: bool) -> None:
        found = _PLAIN.fullmatch(command)
        if command == b"" and escaped:  # the escape of the data mode
            client.state[0] = False
            self._answer(client, b"", OK)
            return
        if found is None:
            self._answer(client, b"", BAD)
            return
        name, value = found[1], int(found[2]) if found[2] else None
        match name:
            case b"C":
                self._answer(client, name, OK)
                client.state[0] = False
            case b"O":
                client.state[0] = True
            case b"!AR" if value is not None and 1 <= value <= BROADCAST:
                self._remote = value
                self._answer(client, name, OK)
            case b"!AL" if value is not None and 1 <= value < BROADCAST:
                self._modem.address = value
                self._answer(client, name, OK)
            case b"!L" if value in _LEVELS:
                self._level = value or 0  # it is kept, and changes nothing in the water
                self._answer(client, name, OK)
            case b"!AR" | b"!L" | b"!AL":
                self._answer(client, name, b"ERROR OUT OF RANGE")
            case b"?AL" | b"?AR" | b"?L" | b"?T" | b"?AM":
                known = {b"?AL": self._modem.address, b"?AR": self._remote, b"?L": self._level,
                         b"?T": self._modem.travel_us, b"?AM": max(self._modem.sea.addresses.values())}  # fmt: skip
                self._answer(client, name, str(known[name]).encode())
            case b"?DI":
                self._answer(client, name, b"PENDING" if self._waiting else b"EMPTY")
            case b"Z":
                self._modem.clear()
                self._answer(client, name, OK)
            case _:
                self._answer(client, name, NOT_HERE)

    def _send(self, client: Client, found: re.Match[bytes], data: bytes, whole: bytes) -> None:
        instant, length, to = found[1] is not None, int(found[2]), int(found[3])
        name = b"*SENDIM" if instant else b"*SEND"
        data = data[:-1] if len(data) == length + 1 and data.endswith(b"\r") else data
        if len(data) < length:  # a line feed was a part of the message
            client.state[1] = whole
            return
        if len(data) > length or (instant and (found[4] is None or length > MOST_MESSAGE)):
            self._answer(client, name, BAD)
            return
        answered = found[4] in (b"ack", b"force") if instant else True
        self._answer(client, name, self._submit(to, data, instant=instant, answered=answered))

    def _burst(self, client: Client, data: bytes) -> None:
        if self._remote and data:
            self._submit(self._remote, data, instant=False, answered=True)

    def _submit(self, to: int, data: bytes, *, instant: bool, answered: bool) -> bytes:
        """Send a message. Returns the answer to its command."""
        address, kind = EVERYBODY if to == BROADCAST else to, b"im" if instant else b"burst"

        def sent(frame: SentFrame) -> None:
            self._tell(b"SENDSTART,%d,%b,%d,0" % (to, kind, frame.airtime_ns // 1000))
            end_us = self._modem.us(frame.at_ns + frame.airtime_ns)
            said = b"SENDEND,%d,%b,%d,%d" % (to, kind, end_us, frame.airtime_ns // 1000)
            self._modem.after(frame.airtime_ns / 1e9, lambda: self._tell(said))

        def ends(delivered: bool) -> None:
            self._waiting -= 1
            word = b"DELIVERED" if delivered else b"FAILED"
            if instant:
                self._tell(b"%bIM,%d" % (word, to))
            else:
                self._delivered += delivered
                self._tell(b"%b,%d,%d" % (word, self._delivered, to))

        job = Job(data, address, INSTANT if instant else BURST, sent)
        answered &= address != EVERYBODY
        if self._modem.deliver(job, 1, ends) if answered else self._modem.submit(job):
            return b"BUSY DELIVERING" if self._modem.waits else b"ERROR OUT OF RANGE"
        self._waiting += answered
        return OK

    def pinged(self, frame: HeardFrame) -> None:
        """See `ModemLanguage`. Its language has no word for it."""

    def begins(self, sound: Sound) -> None:
        """See `ModemLanguage`."""
        self._tell(b"RECVSTART")

    def heard(self, frame: HeardFrame, *, linked: bool) -> None:
        """See `ModemLanguage`. Levels are not known to the channel: the signal strength is 0."""
        data, to = frame.payload, frame.to or BROADCAST
        duration_us = self._modem.sea.modem.airtime_ns(len(data)) // 1000
        self._tell(b"RECVEND,%d,%d,0,100" % (self._modem.us(frame.end_ns), duration_us))
        if frame.what == INSTANT:
            flag = b"ack" if linked else b"noack"
            self._tell(b"RECVIM,%d,%d,%d,%b,%d,0,100,0.0000,%b" % (len(data), frame.src, to, flag, duration_us, data))
        elif frame.what == BURST:
            rate = round(8e6 * len(data) / max(1, duration_us))
            head = b"RECV,%d,%d,%d,%d,0,100,%d,0.0000," % (len(data), frame.src, to, rate, self._modem.travel_us)
            self._tell(head + data)

    def spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """See `ModemLanguage`."""
        self._tell(b"RECVFAILED,0.0000,0,0")


def _framed(command: bytes, said: bytes) -> bytes:
    """An answer in the data mode: its command, its length, and itself."""
    return b"+++AT%b:%d:%b\r\n" % (command, len(said), said)
