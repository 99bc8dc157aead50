"""The modems of a run in lockstep that agents have of their own: they are told what happens to their frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from netem.acoustic import AcousticChannel
from netem.config import NetemConfig
from netem.medium import Place
from netem.modem_frame import MARK, NEWS, SWITCH_ON, read_frame
from netem.modem_news import Began, ModemNews, News, Spoiled, SwitchedOn
from netem.transit import PendingPacket, Transit
from netem.wire.messages import Delivery

_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[News]).decode
Transmissions = Mapping[int, tuple[bytes, ...]]


def read_news(payload: bytes) -> list[News]:
    """The news of a payload. Raises msgspec.MsgspecError: it holds none."""
    return _decode(payload[len(NEWS) :])


class LockstepModems:
    """The modems that are switched on, and their news."""

    def __init__(self, config: NetemConfig, water: AcousticChannel, transit: Transit) -> None:
        """Prepare them; none is switched on."""
        assert config.acoustic is not None
        self._config, self._acoustic, self._water, self._transit = config, config.acoustic, water, transit
        self._news: ModemNews | None = None  # None: nobody wants to know
        self._on: dict[int, bool] = {}  # whether a modem that is switched on has been told what it is
        self._names: dict[tuple[int, int], int] = {}  # of frames without a final fate, by sender and number

    def take(self, transmissions: Transmissions) -> tuple[Transmissions, Mapping[tuple[int, int], int]]:
        """Take what is said to modems out of the payloads of a round.

        Returns:
            the payloads that are transmitted, and the ticks at which some of them have to start, by their sender and
            number.
        """
        if not any(payload.startswith(MARK) for payloads in transmissions.values() for payload in payloads):
            return transmissions, {}
        left, starts = dict[int, tuple[bytes, ...]](), dict[tuple[int, int], int]()
        for src, payloads in transmissions.items():
            if SWITCH_ON in payloads:
                self._on[src] = False
                self._news = self._news or self._listening()
            left[src] = tuple(payload for payload in payloads if payload != SWITCH_ON)
            for seq, payload in enumerate(left[src], self._water.next_number(src)):
                if (frame := read_frame(payload)) is not None:
                    self._names[src, seq] = frame.name
                    if frame.at_ns is not None:
                        starts[src, seq] = -(-frame.at_ns // self._config.tick_ns)
        return left, starts

    def tell(
        self,
        tick: int,
        until: int,
        inboxes: dict[int, tuple[Delivery, ...]],
        arrived: Sequence[PendingPacket],
        places: Mapping[int, Place],
    ) -> None:
        """Put what modems notice in a round into the inboxes of their agents.

        Args:
            tick: the round tick.
            until: the next one.
            inboxes: of the living, which get a payload of news before all else of a tick.
            arrived: the packets in these inboxes.
            places: of the vehicles that are alive [m, NED].
        """
        if self._news is None:
            return
        told: dict[tuple[int, int], list[News]] = {}  # by vehicle and tick
        for i, knows in self._on.items():
            if not knows and i in inboxes:
                self._on[i] = True
                told[i, tick + 1] = [self._station(i)]
        for i, event in self._news.take(self._on):
            at_ns = event.at_ns if isinstance(event, Began | Spoiled) else 0
            due = min(until, max(tick + 1, -(-at_ns // self._config.tick_ns)))
            told.setdefault((i, due), []).append(event)
        for packet in arrived:
            # A damaged frame may have lost its mark, so there it counts who said it.
            of_a_modem = packet.src in self._on if packet.corrupted else packet.payload.startswith(MARK)
            if packet.dst in self._on and of_a_modem:
                news = self._news.damaged_frame(packet) if packet.corrupted else self._news.arrival(packet, places)
                told.setdefault((packet.dst, packet.due_tick), []).append(news)
        for (i, due), events in told.items():
            if i in inboxes:
                first = Delivery(due, tick, i, 0, 0, NEWS + _encode(events))
                inboxes[i] = tuple(sorted((first, *inboxes[i]), key=lambda each: each.due_tick))
        if self._names:
            under_way = self._water.under_way()
            self._names = {each: name for each, name in self._names.items() if each in under_way}

    def _listening(self) -> ModemNews:
        def called(src: int, seq: int) -> int | None:
            return self._names.get((src, seq))

        return ModemNews(self._config, self._water, self._transit, called)

    def _station(self, i: int) -> SwitchedOn:
        config, acoustic = self._config, self._acoustic
        return SwitchedOn(
            acoustic.modem_of(i), acoustic.longest(config.tick_ns, i), acoustic.buffer,
            acoustic.longest_access_s(config.tick_ns, len(config.vehicles)), acoustic.sound_speed, config.seed,
        )  # fmt: skip

    def take_over(self, before: LockstepModems) -> None:
        """Go on with the modems of another run."""
        self._on, self._names = before._on, before._names
        if before._news is not None:
            self._news = self._listening()
            self._news.take_over(before._news)
