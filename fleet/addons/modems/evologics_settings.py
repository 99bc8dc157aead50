"""The settings of an EvoLogics modem, and the plain questions about it.

The names are those that public drivers send: evins (role_at.erl, fsm_conf.erl), DUNE (Transports/Evologics/Driver.hpp),
Rock (usbl_evologics), and those of signetlabdei, oceansystemslab and GSO-soslab on GitHub. What a modem has at first,
and which values it takes, is an assumption where the comment names no source.
"""

from __future__ import annotations

from typing import NamedTuple

from fleet.addons.modems.modem import ModemCore

OK = b"OK"
FIRMWARE = b"1.9"  # of which Rock and others write
# DUNE reads the numbers of these.
VERSIONS = {b"I0": FIRMWARE, b"I1": b"phy: v0.0, mac: v0.0", b"I7": b"uuv-fleet"}


class Setting(NamedTuple):
    """A number that programs set and read."""

    first: int
    least: int
    most: int


# They are kept, and change nothing in the water, but for the last three.
NUMBERS = {
    b"L": Setting(0, 0, 3),  # source level; 0 is the loudest
    b"LC": Setting(0, 0, 1),
    b"G": Setting(0, 0, 1),
    b"C": Setting(0, 0, 15),
    b"ZC": Setting(10, 1, 32),
    b"ZP": Setting(500, 500, 1200),  # the limits are those that Rock's USBL_MANUAL found
    b"RC": Setting(3, 0, 255),
    b"RT": Setting(2000, 500, 12_000),
    b"RI": Setting(1, 0, 255),
    b"KO": Setting(0, 0, 255),
    b"ZI": Setting(120, 0, 3600),
    b"ZH": Setting(0, 0, 3600),
    b"AM": Setting(0, 1, 254),  # 0: the greatest address of the modems there are
    b"RP": Setting(0, 0, 0),  # what is for others is not heard
    b"AR": Setting(0, 1, 255),  # the address of burst data
    b"ZS": Setting(0, 0, 7),  # the protocol number of messages that name none
    b"CA": Setting(0, 1300, 1700),  # m/s; 0: the speed of sound in the channel
}
# 1: on. With ZX a modem tells what is on the air, with ZU where it comes from, and with ZF protocol numbers. That ZX is
# off at first is an assumption: evins switches it on, and signetlabdei's driver takes RECVSTART for a message.
SWITCHES = {b"ZX": 0, b"ZU": 1, b"ZF": 0, b"ZA": 0}
# The words of AT&V for settings: those of Rock's test_UsblParser.cpp.
_TITLES = {
    b"Source Level": b"L", b"Source Level Control": b"LC", b"Gain": b"G", b"Carrier Waveform ID": b"C",
    b"Local Address": b"AL", b"Highest Address": b"AM", b"Cluster Size": b"ZC", b"Packet Time": b"ZP",
    b"Retry Count": b"RC", b"Retry Timeout": b"RT", b"Promiscuous Mode": b"RP", b"Sound Speed": b"CA",
    b"IM Retry Count": b"RI", b"Hold Timeout": b"ZH", b"Idle Timeout": b"ZI",
}  # fmt: skip


class Settings:
    """What programs have set of one modem."""

    def __init__(self) -> None:
        self.numbers = {name: setting.first for name, setting in NUMBERS.items()}
        self.switches = dict(SWITCHES)

    def take(self, modem: ModemCore, name: bytes, value: int | None) -> bytes | None:
        """Obey a command that sets or asks something.

        Args:
            modem: whose setting it is.
            name: of the command, with its `!`, `@` or `?`.
            value: its number; None: it has none.

        Returns:
            the answer; None: there is no such setting.
        """
        sign, what = name[:1], name[1:]
        if sign == b"?":
            return self._ask(modem, what)
        if sign == b"@":
            return self._switch(what, value)
        if name == b"!AL":
            return self._readdress(modem, value)
        if sign == b"!" and what in SWITCHES:  # Rock writes AT!ZU, others AT@ZU
            return self._switch(what, value)
        if sign == b"&":
            return self._all(modem, what)
        if sign != b"!" or what not in NUMBERS:
            return None
        if value is None or not NUMBERS[what].least <= value <= NUMBERS[what].most:
            return b"ERROR OUT OF RANGE"
        self.numbers[what] = value
        return OK

    def _switch(self, what: bytes, value: int | None) -> bytes | None:
        if what == b"CTRL":  # of several programs one has the control; here all have it
            return OK
        if what not in SWITCHES:
            return None
        if value not in (0, 1):
            return b"ERROR OUT OF RANGE"
        self.switches[what] = value
        return OK

    def _all(self, modem: ModemCore, what: bytes) -> bytes | None:
        """AT&V lists the settings in the words that Rock knows, with an empty line behind them. AT&W stores them, which
        they are anyway, and with AT&F they are what they were at first."""
        match what:
            case b"W":
                return OK
            case b"F":
                self.numbers, self.switches = dict(Settings().numbers), dict(SWITCHES)
                return OK
            case b"V":
                known = {title: self._ask(modem, name) or b"" for title, name in _TITLES.items()}
                return b"".join(b"%b: %b\r\n" % line for line in known.items())
        return None

    @staticmethod
    def _readdress(modem: ModemCore, value: int | None) -> bytes:
        if value is None or not 1 <= value < NUMBERS[b"AR"].most:  # that is everybody's
            return b"ERROR OUT OF RANGE"
        modem.address = value
        return OK

    def _ask(self, modem: ModemCore, what: bytes) -> bytes | None:
        known = {
            b"AL": modem.address,
            b"AM": self.numbers[b"AM"] or max(modem.channel.addresses.values()),
            b"CA": self.speed(modem),
            b"CLOCK": modem.now_us // 1_000_000,
            b"PID": self.numbers[b"ZS"],
            b"T": modem.travel_us,
        }
        found = known.get(what, self.numbers.get(what, self.switches.get(what)))
        return None if found is None else str(found).encode()

    def speed(self, modem: ModemCore) -> int:
        """The speed of sound [m/s] that the modem reckons with."""
        return self.numbers[b"CA"] or round(modem.channel.sound_speed)
