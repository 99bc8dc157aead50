"""The place between an acoustic channel and a modem that programs of others open: what each side may ask of the other.

A modem's own language (UnetStack, a Micro-Modem, ...) is no affair of the network. So an endpoint is an object that the
console hands over with the settings of the relay, and that translates on a thread of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from netem.cause import Cause
from netem.modem import Modem

EVERYBODY = 0  # the address of a broadcast
MOST_ADDRESS = 255


class ModemRequest(NamedTuple):
    """A payload that a program gives its modem."""

    robot: int
    src: int  # addresses: its own, and that of the modem that it is for, which the channel does not look at
    to: int
    what: int  # protocol number
    payload: bytes
    tag: Any  # what the endpoint calls it
    # What the modem says beside the payload, as in a preamble. It takes no room of it, and no time of its own.
    head: bytes = b""
    at_ns: int | None = None  # when it has to begin, of CLOCK_MONOTONIC, whoever's turn it is; None: by medium access


class SentFrame(NamedTuple):
    """A payload begins to be transmitted."""

    tag: Any
    at_ns: int  # of CLOCK_MONOTONIC
    airtime_ns: int


class Level(NamedTuple):
    """How strong a transmission is where it is heard, with its fading."""

    received: float  # dB re 1 uPa
    snr: float  # dB, over the noise in the band of the modem that hears it


UNKNOWN = Level(0.0, 0.0)


class HeardFrame(NamedTuple):
    """A payload has arrived whole, whoever it is for."""

    src: int  # addresses
    to: int
    what: int
    payload: bytes
    sent_ns: int  # when its transmission began
    begin_ns: int  # when its reception began
    end_ns: int  # when the modem has it
    head: bytes = b""  # see `ModemRequest`
    level: Level = UNKNOWN
    away: tuple[float, ...] | None = None  # north, east, down [m]: from here to its modem, where they are now


class Sound(NamedTuple):
    """A transmission of another modem, as one hears it, whoever it is for and whether it can be read or not."""

    begin_ns: int  # of CLOCK_MONOTONIC; it may be later than now
    end_ns: int


class ModemChannel(NamedTuple):
    """What an endpoint may ask of the channel, from any thread."""

    modem: Modem
    mtu: int  # bytes of the longest payload
    queue: int  # payloads that wait at most
    access_s: float  # the longest that a free modem waits for its turn to talk
    sound_speed: float  # m/s
    begin_ns: int  # when the modems were switched on, of CLOCK_MONOTONIC: t = 0, or before programs get ready
    seed: int  # of the run
    name: str  # of its robot
    addresses: dict[str, int]  # of all modems at the beginning, by name of the robot
    send: Callable[[ModemRequest], None]
    place: Callable[[], tuple[float, ...]]  # north, east, down [m]
    move: Callable[[tuple[float, ...]], None]

    @property
    def there_and_back_s(self) -> float:
        """The longest that sound takes to a modem that hears this one, and back [s]."""
        return 2 * self.modem.max_range / self.sound_speed


class ModemEndpoint(Protocol):
    """A modem that programs of one robot open. The thread of the relay calls it, and must not be held up."""

    number: int  # of its robot
    address: int

    def listen(self) -> str:
        """Open its port. Returns the port, or the path of its terminal. Raises BusError: it cannot be opened."""

    def begin(self, channel: ModemChannel) -> None:
        """The channel carries from now on."""

    def on_sent(self, frame: SentFrame) -> None:
        """A payload of it begins to be transmitted."""

    def on_dropped(self, tag: Any, cause: Cause) -> None:
        """A payload of it is lost before it was transmitted."""

    def on_heard(self, frame: HeardFrame) -> None:
        """A payload has arrived here, whoever it is for."""

    def on_reached(self, sound: Sound) -> None:
        """A transmission of another modem is on its way here."""

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """A reception here has failed, and why."""

    @property
    def remark(self) -> str:
        """What became of it, for the result of the run; empty: nothing to tell."""

    def close(self) -> None:
        """Close its port, and every connection."""
