"""The network's place in the lockstep: collect a round's transmissions, exchange, answer.

A pure state machine: messages in, addressed messages out. It exchanges round k once the world has said who is
alive at k and exactly those vehicles have transmitted. On an ideal network it does not wait for the world,
whose commands of the same tick depend on the exchange.
"""

from __future__ import annotations

from netem.acoustic import AcousticNetem
from netem.config import NetemConfig
from netem.errors import OutOfPlace
from netem.messages import Inbox, LinkReport, Round, Transmission
from netem.network import Netem


class Rounds:
    """Feeds `Netem` with whole rounds."""

    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        self.netem = Netem(config) if config.acoustic is None else AcousticNetem(config)
        self._next = 0
        self._incarnation = dict.fromkeys(config.vehicles, 0)
        self._transmissions: dict[int, dict[int, tuple[bytes, ...]]] = {}
        self._alive: dict[int, tuple[int, ...]] = {}

    @property
    def tick(self) -> int:
        """The round tick waited for."""
        return self._next

    @property
    def missing(self) -> list[int]:
        """The vehicles whose transmission of the awaited round has not come."""
        have = self._transmissions.get(self._next, {})
        return [i for i in self._alive.get(self._next, self.config.vehicles) if i not in have]

    def transmission(self, i: int, message: Transmission) -> None:
        """Take vehicle i's transmission.

        Raises:
            OutOfPlace: not a round tick, one that was already exchanged or taken, or of another incarnation.
        """
        if message.incarnation != self._incarnation[i]:
            raise OutOfPlace("incarnation", self._incarnation[i], message.incarnation)
        m = self.config.round_ticks
        taken = self._transmissions.setdefault(message.tick, {})
        if message.tick % m or not self._next <= message.tick <= self._next + m or i in taken:
            if not taken:
                del self._transmissions[message.tick]
            expected = self._next if i not in self._transmissions.get(self._next, {}) else self._next + m
            raise OutOfPlace("round tick", expected, message.tick)
        taken[i] = message.payloads

    def round(self, message: Round) -> None:
        """Take the world's word on who is alive at a round tick.

        Raises:
            OutOfPlace: not the next round.
        """
        if message.tick != self._next:
            raise OutOfPlace("round", self._next, message.tick)
        self._alive[message.tick] = message.alive

    def exchange(self) -> tuple[list[tuple[int, Inbox]], LinkReport] | None:
        """The next round's outcome if everything for it is in: (vehicle, inbox) pairs and the report."""
        tick = self._next
        alive = self.config.vehicles if self.config.ideal else self._alive.get(tick)
        have = self._transmissions.get(tick, {})
        if alive is None or any(i not in have for i in alive):
            return None
        self._alive.pop(tick, None)
        self._transmissions.pop(tick, None)
        inboxes, fates = self.netem.exchange(tick, {i: have[i] for i in alive})
        self._next = tick + self.config.round_ticks
        until = tick if self.config.ideal else self._next
        out = [(i, Inbox(self._incarnation[i], until, False, deliveries)) for i, deliveries in inboxes.items()]
        return out, LinkReport(tick, False, False, fates)

    def close(self, end_tick: int) -> LinkReport:
        """The last report of a run that ended before tick `end_tick` was started."""
        return LinkReport(end_tick, True, False, self.netem.close(end_tick))
