"""The netem process of a realtime run: in the middle of each tick it hands out what is due at the next."""

from __future__ import annotations

from contextlib import suppress
from queue import Empty
from time import monotonic_ns

from netem.process import NetworkProcess
from netem.realtime_rounds import RealtimeRounds
from netem.wire.bus import Bus, Respond
from netem.wire.control import read_map
from netem.wire.credentials import NETEM
from netem.wire.keys import Keys
from netem.wire.mailbox import Item
from netem.wire.messages import (
    Message,
    Pace,
    Receipt,
    Round,
    Transmission,
)

REST_S = 0.1
MOST_REST = 10_000


class RealtimeNetemProcess(NetworkProcess[RealtimeRounds]):
    """Exchanges when a tick is half over. The world sends the pace anew every round."""

    _pace = Pace(0, 0, 1)

    def _listen(self, bus: Bus, keys: Keys) -> None:
        self._mailbox.subscribe(keys.tx("*"))
        self._mailbox.answer(keys.ctl(NETEM))

    def serve(self) -> None:
        """Tick by tick, until the process is ended."""
        rounds, mailbox = self._rounds, self._mailbox
        while True:
            wait = (self._middle_ns(rounds.tick) - monotonic_ns()) / 1e9 if rounds.known else None
            if wait is None or wait > 0:
                with suppress(Empty):
                    self._handle(mailbox.take(wait))
                continue
            # What is there by now still belongs to this tick.
            for _ in range(mailbox.queue.qsize()):
                self._handle(mailbox.take())
            if not rounds.known:
                continue  # among it was that the run is over
            inboxes, report = rounds.exchange(monotonic_ns())
            self._hand_out(inboxes)
            if report is not None:
                self._report(report)

    def _handle(self, item: Item) -> None:
        if item.respond is None:
            self._put(item.key, item.data)
        else:
            self._query(item.key, item.data, item.respond)

    def _control(self, data: bytes, respond: Respond) -> None:
        if read_map(data).get("op") == "close":
            self._put_rest()
        super()._control(data, respond)

    def _put_rest(self) -> None:
        """Take puts until none comes any more: the last rounds may be behind the question to close."""
        held = []
        with suppress(Empty):
            for _ in range(MOST_REST):
                item = self._mailbox.take(REST_S)
                if item.respond is None:
                    self._put(item.key, item.data)
                else:
                    held.append(item)
        for item in held:
            self._mailbox.queue.put(item)

    def _middle_ns(self, tick: int) -> int:
        return self._begin_ns(tick) + self._pace.period_ns // 2

    def _begin_ns(self, tick: int) -> int:
        return self._pace.at_ns + (tick - self._pace.tick) * self._pace.period_ns

    def _from_agent(self, i: int, message: Message) -> None:
        if isinstance(message, Receipt):
            self._rounds.receipt(i, message, self._begin_ns)
        elif isinstance(message, Transmission):
            self._rounds.transmission(i, message)

    def _from_world(self, message: Message) -> None:
        if isinstance(message, Pace):
            self._pace = message
        elif isinstance(message, Round):
            self._rounds.round(message)
