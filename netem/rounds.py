"""The network's place in the lockstep: collect a round's transmissions, exchange, answer.

`Rounds` is a pure state machine: messages in, addressed messages out. It exchanges round k when two conditions hold.
The world's Round message has named the vehicles with an agent at k, and each of them that is not suspended has
transmitted. On an ideal network it does not wait for the world, because the commands of tick k depend on the exchange.
"""

from __future__ import annotations

from typing import Any

from netem.config import NetemConfig
from netem.errors import OutOfPlace
from netem.lives import Lives
from netem.network import Netem
from netem.wire.messages import Inbox, LinkReport, Round, Transmission


class Rounds:
    """Collects transmissions until a round is complete, and then lets `Netem` exchange it."""

    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        self.netem = Netem(config)
        self._next = 0
        self.lives = Lives(config.absences)
        self._transmissions: dict[int, dict[int, tuple[bytes, ...]]] = {}
        self._alive: dict[int, Round] = {}

    @property
    def tick(self) -> int:
        return self._next

    @property
    def missing(self) -> list[int]:
        """The vehicles whose transmission of the awaited round has not come."""
        have = self._transmissions.get(self._next, {})
        return [i for i in self._speakers(self._next) or self.config.vehicles if i not in have]

    def transmission(self, i: int, message: Transmission) -> None:
        """Take a transmission.

        Args:
            i: number of the sending vehicle.
            message: its payloads of a round tick.

        Raises:
            OutOfPlace: not a round tick, a tick that was already exchanged or taken, or another incarnation.
        """
        incarnation = self.lives.check(i, message.tick, message.incarnation)
        m = self.config.round_ticks
        # An agent needs the inbox of one round to transmit in the next, but for its first, while others lag behind.
        begins = incarnation > self.lives.incarnation(i, self._next)
        latest = message.tick if begins else self._next + m
        taken = self._transmissions.setdefault(message.tick, {})
        if message.tick % m or not self._next <= message.tick <= latest or i in taken:
            if not taken:
                del self._transmissions[message.tick]
            expected = self._next if i not in self._transmissions.get(self._next, {}) else self._next + m
            raise OutOfPlace("round tick", expected, message.tick)
        taken[i] = message.payloads

    def round(self, message: Round) -> None:
        """Take from the world who is alive at a round tick.

        Raises:
            OutOfPlace: not the next round.
        """
        if message.tick != self._next:
            raise OutOfPlace("round", self._next, message.tick)
        self._alive[message.tick] = message

    def exchange(self) -> tuple[list[tuple[int, Inbox]], LinkReport] | None:
        """Close the next round, if everything for it is in.

        Returns:
            Pairs of a vehicle and its inbox, and the report to the console; None: something is still missing.
        """
        tick = self._next
        speakers = self.config.vehicles if self.config.ideal else self._speakers(tick)
        have = self._transmissions.get(tick, {})
        if speakers is None or len(have) < len(speakers) or any(i not in have for i in speakers):
            return None
        where = self._alive.pop(tick, None)
        self._transmissions.pop(tick, None)
        positions = None if where is None else dict(zip(where.alive, where.positions, strict=True))
        inboxes, fates = self.netem.exchange(tick, {i: have[i] for i in speakers}, positions)
        self._next = tick + self.config.round_ticks
        until = tick if self.config.ideal else self._next
        out = [
            (i, Inbox(self.lives.incarnation(i, tick), until, False, deliveries)) for i, deliveries in inboxes.items()
        ]
        return out, LinkReport(tick, False, False, fates)

    def _speakers(self, tick: int) -> list[int] | None:
        where = self._alive.get(tick)
        return None if where is None else [i for i in where.alive if i not in where.paused]

    def close(self, end_tick: int) -> LinkReport:
        """The last report of a run that ended before tick `end_tick` was started."""
        return LinkReport(end_tick, True, False, self.netem.close(end_tick))

    def timing(self) -> dict[str, Any]:
        """Empty: in lockstep nothing is late."""
        return {}

    def take_over(self, before: Rounds) -> None:
        """Go on at the next round from the network of another run on the same graph."""
        self.netem.take_over(before.netem)
        self._next = before._next
