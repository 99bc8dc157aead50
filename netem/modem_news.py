"""What modems notice of an acoustic channel: what begins to be transmitted, where it is heard, and what is spoiled.

Times are those of the run [ns], from the begin of its tick 0.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

from msgspec import Struct

from netem.acoustic import AcousticChannel
from netem.cause import Cause
from netem.config import NetemConfig
from netem.endpoint import UNKNOWN, HeardFrame, Level, ModemEndpoint, SentFrame, Sound
from netem.medium import Place
from netem.modem import Modem
from netem.station import Burst
from netem.transit import PendingPacket, Transit

_MOST_BURSTS = 10_000  # transmissions that are remembered
_NOTICED = frozenset({Cause.COLLISION, Cause.SNR})  # what a receiver's modem notices of the causes of a loss


class SwitchedOn(Struct, frozen=True, array_like=True, tag=0):
    """A modem, as the channel knows it: the first of its news."""

    modem: Modem
    mtu: int  # bytes of the longest payload
    queue: int  # payloads that wait at most
    access_s: float  # the longest that a free modem waits for its turn to talk
    sound_speed: float  # m/s
    seed: int  # of the run


class Began(Struct, frozen=True, array_like=True, tag=1):
    """A payload of this modem begins to be transmitted."""

    payload: int  # what its sender calls it
    at_ns: int
    airtime_ns: int


class Unsent(Struct, frozen=True, array_like=True, tag=2):
    """A payload of this modem was lost before it was transmitted."""

    payload: int
    cause: Cause


class SoundReached(Struct, frozen=True, array_like=True, tag=3):
    """A transmission of another modem is on its way here."""

    begin_ns: int  # it may be later than now
    end_ns: int


class Spoiled(Struct, frozen=True, array_like=True, tag=4):
    """A reception here has failed, and why."""

    cause: Cause
    at_ns: int
    level: Level


class FrameArrived(Struct, frozen=True, array_like=True, tag=5):
    """A payload has arrived whole: number `seq` and copy `copy` of vehicle `src`."""

    src: int
    seq: int
    copy: int
    sent_ns: int  # when its transmission began
    begin_ns: int  # when its reception began
    end_ns: int  # when the modem has it
    level: Level
    away: tuple[float, ...] | None  # north, east, down [m]: from here to its modem, where they are now

    def frame(self, src: int, to: int, what: int, payload: bytes, head: bytes, begin_ns: int) -> HeardFrame:
        """What a modem hears with it, of the words of its sender. `begin_ns`: of tick 0 [CLOCK_MONOTONIC]."""
        return HeardFrame(
            src, to, what, payload, begin_ns + self.sent_ns, begin_ns + self.begin_ns, begin_ns + self.end_ns, head,
            self.level, self.away,
        )  # fmt: skip


News = SwitchedOn | Began | Unsent | SoundReached | Spoiled | FrameArrived


def tell(modem: ModemEndpoint, event: Began | Unsent | SoundReached | Spoiled, begin_ns: int) -> None:
    """Hand a piece of news to a modem. `begin_ns`: of tick 0 [CLOCK_MONOTONIC]."""
    match event:
        case Began():
            modem.on_sent(SentFrame(event.payload, begin_ns + event.at_ns, event.airtime_ns))
        case Unsent():
            modem.on_dropped(event.payload, event.cause)
        case SoundReached():
            modem.on_reached(Sound(begin_ns + event.begin_ns, begin_ns + event.end_ns))
        case Spoiled():
            modem.on_spoiled(event.cause, begin_ns + event.at_ns, event.level)


class ModemNews:
    """The news of the modems of a run."""

    def __init__(
        self,
        config: NetemConfig,
        water: AcousticChannel,
        transit: Transit,
        called: Callable[[int, int], int | None],
    ) -> None:
        """Listen to a channel.

        Args:
            config: of the run; it has an acoustic channel.
            water: that channel. Its `begun` and `unsent` are taken here alone.
            transit: the channel puts into it what is lost.
            called: gets a sender and the number of a payload. Returns what the sender's modem calls it. None: the modem
                is not told of this payload.
        """
        assert config.acoustic is not None
        self._acoustic, self._tick_ns = config.acoustic, config.tick_ns
        self._water, self._transit, self._called = water, transit, called
        self._bursts: dict[tuple[int, int], Burst] = {}  # by sender and number of a payload
        water.begun, transit.spoiled = [], []

    def take(self, modems: Collection[int]) -> Iterator[tuple[int, Began | Unsent | SoundReached | Spoiled]]:
        """What has happened since the last call at some vehicles, each with its news."""
        water, tick_ns = self._water, self._tick_ns
        for seq, burst in water.begun or ():
            at_ns, airtime_ns = burst.start_tick * tick_ns, burst.airtime_ns
            for i, _, travel_ns in burst.heard:
                if i in modems:
                    yield i, SoundReached(at_ns + travel_ns, at_ns + travel_ns + airtime_ns)
            if seq is None:  # an answer of the channel's own
                continue
            self._bursts[burst.src, seq] = burst
            if burst.src in modems and (name := self._called(burst.src, seq)) is not None:
                yield burst.src, Began(name, at_ns, airtime_ns)
        for src, seq, cause in water.unsent:
            if src in modems and (name := self._called(src, seq)) is not None:
                yield src, Unsent(name, cause)
        for fate in self._transit.spoiled or ():
            if fate.cause in _NOTICED and fate.dst in modems:
                yield fate.dst, Spoiled(fate.cause, fate.final_tick * tick_ns, self.level(fate.src, fate.seq, fate.dst))
        water.begun, water.unsent, self._transit.spoiled = [], [], []
        while len(self._bursts) > _MOST_BURSTS:
            del self._bursts[next(iter(self._bursts))]

    def arrival(self, packet: PendingPacket, places: Mapping[int, Place]) -> FrameArrived:
        """The news of a packet that has arrived whole. `places`: of the vehicles that are known [m, NED]."""
        src, dst, seq = packet.src, packet.dst, packet.seq
        end_ns = packet.sent_tick * self._tick_ns + packet.delay_ns
        sent_ns, airtime_ns = end_ns, 0
        if (burst := self._bursts.get((src, seq))) is not None:
            sent_ns, airtime_ns = burst.start_tick * self._tick_ns, burst.airtime_ns
        begin_ns = end_ns - round(self._acoustic.modem_of(dst).processing * 1e9) - airtime_ns
        here, there = places.get(dst), places.get(src)
        away = None if here is None or there is None else tuple(b - a for a, b in zip(here, there, strict=True))[:3]
        return FrameArrived(src, seq, packet.copy, sent_ns, begin_ns, end_ns, self.level(src, seq, dst), away)

    def damaged_frame(self, packet: PendingPacket) -> Spoiled:
        """The news of a packet that has arrived damaged: modems have checksums."""
        at_ns = packet.due_tick * self._tick_ns
        return Spoiled(Cause.SNR, at_ns, self.level(packet.src, packet.seq, packet.dst))

    def level(self, src: int, seq: int, dst: int) -> Level:
        """How strong the transmission of a payload is at a vehicle; UNKNOWN: it is forgotten."""
        burst = self._bursts.get((src, seq))
        return UNKNOWN if burst is None else self._water.level(burst, dst)

    def take_over(self, before: ModemNews) -> None:
        """Go on with what was transmitted in another run."""
        self._bursts = before._bursts
