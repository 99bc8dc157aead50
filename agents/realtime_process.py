"""The process of an agent on a wall clock."""

from __future__ import annotations

from agents.loop import RealtimeLoop
from agents.process import AgentProcess
from netem.errors import MalformedMessage, OutOfPlace
from netem.wire.bus import Bus
from netem.wire.codec import expect
from netem.wire.keys import Keys
from netem.wire.messages import (
    End,
    Hello,
    Inbox,
    Nav,
)
from netem.wire.queues import Stamped


class RealtimeAgentProcess(AgentProcess):
    """An agent on a wall clock: answers the newest nav that is there, and ends as `AgentProcess` does."""

    def __init__(self, bus: Bus, keys: Keys, vehicle: int, loop: RealtimeLoop) -> None:
        super().__init__(bus, keys, vehicle, loop)
        self._realtime = loop
        self._noted_flood = False

    def _listen(self, bus: Bus, key: str) -> Stamped:
        self._stamped = bus.stamped_queue(key)
        return self._stamped

    def serve(self) -> End:
        """Answer navs until the world ends this life. If the console started this process, it ends it instead."""
        poll = self._navs.poll
        while True:
            item: tuple[str, bytes] | None = self._navs.get()
            navs = []
            while item is not None:
                message = self._read(*item)
                if isinstance(message, End) and self._agent.is_over(message):
                    return message
                if isinstance(message, Nav):
                    navs.append(message)
                item = poll()
            while (came := self._stamped.poll()) is not None:
                key, data, at_ns = came
                message = self._read(key, data)
                if isinstance(message, Inbox):
                    self._take(key, message, at_ns)
            if self._stamped.flooded and not self._noted_flood:
                self._noted_flood = True
                self._agent.mailbox.note(
                    self._vehicle, self._loop.tick, "more comes in than it takes: messages are dropped"
                )
            for nav in self._realtime.to_answer(navs) if navs else ():
                self._answer(self._keys.nav(self._vehicle), nav)

    def _read(self, key: str, data: bytes) -> Nav | Inbox | End | Hello | None:
        try:
            message = expect(data, Nav, Inbox, End, Hello)
        except MalformedMessage as error:
            self._agent.mailbox.reject(key, self._loop.tick, error)
            return None
        assert isinstance(message, (Nav, Inbox, End, Hello))
        return message

    def _take(self, key: str, inbox: Inbox, at_ns: int) -> None:
        try:
            self._realtime.arrive(inbox, at_ns)
        except OutOfPlace as error:
            self._agent.mailbox.reject(key, self._loop.tick, error)
