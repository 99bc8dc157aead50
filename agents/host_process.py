"""One process, and one session, for several agents in lockstep.

Each agent has its own core, loop and life. Their messages come together, and so do their answers, because a fleet of
a thousand processes spends its time on waking them.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable

from agents.host_progress import Running
from agents.process import OneAgent, probe_until_answered
from netem.errors import MalformedMessage
from netem.wire.bundles import bundles
from netem.wire.bus import Bus
from netem.wire.codec import encode, expect
from netem.wire.credentials import NETEM, WORLD, host_role
from netem.wire.keys import Keys
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Bundle,
    BundlePart,
    End,
    Ended,
    Hello,
    Inbox,
    Nav,
    Receipt,
    Transmission,
)


class HostProcess:
    """Passes what comes in to its agents and publishes what comes out."""

    def __init__(self, bus: Bus, keys: Keys, number: int, agents: Iterable[OneAgent], running: Running) -> None:
        """Connect; the agents are ready to be asked. `number`: of the host, from 1. `running`: receives the number of
        the agent that computes.
        """
        role = host_role(number)
        self._bus, self._number, self._running = bus, number, running
        self._alive = keys.alive(role)
        self._agents = {agent.vehicle: agent for agent in agents}
        self._cmd, self._tx, self._note = (bus.publisher(key(role)) for key in (keys.cmd, keys.tx, keys.note))
        self._key = keys.host(number)
        # Navs and inboxes come in one channel: of two, the one that is not looked at could hold back the other.
        self._in = bus.channel(self._key, capacity=max(64, 3 * len(self._agents)))
        self._to_world: list[BundlePart] = []
        self._to_netem: list[BundlePart] = []

    def get_ready(self) -> None:
        """Probe until world and netem have both answered, then declare the agents ready. Raises BusError if one of them
        does not answer.
        """
        probe = encode(Hello("host", self._number, 0, PROTOCOL_VERSION, False))
        probe_until_answered(probe, {WORLD: self._cmd, NETEM: self._tx}, self._heard)
        ready = [
            BundlePart(i, encode(Hello("agent", i, agent.loop.incarnation, PROTOCOL_VERSION, True)))
            for i, agent in self._agents.items()
        ]
        for data in bundles(ready):
            self._cmd(data)
        self._bus.token(self._alive)

    def _heard(self, _: list[str]) -> list[str]:
        heard = []
        while (item := self._in.poll()) is not None:
            message = expect(item[1], Hello)
            assert isinstance(message, Hello)
            heard.append(message.role)
        return heard

    def serve(self) -> None:
        """Answer one bundle after the other, until the process is ended."""
        take, poll, running = self._in.get, self._in.poll, self._running
        while True:
            item: tuple[str, bytes] | None = take()
            while item is not None:  # what is there already is answered together
                message = expect(item[1], Bundle, Hello)
                if isinstance(message, Bundle):  # else a late echo of a repeated probe
                    for part in message.parts:
                        self._pass(part)
                item = poll()
            running.at(0)
            self._publish()

    def _publish(self) -> None:
        for parts, put in ((self._to_netem, self._tx), (self._to_world, self._cmd)):
            if parts:
                for data in bundles(parts):
                    put(data)
                parts.clear()

    def _pass(self, part: BundlePart) -> None:
        i = part.vehicle
        agent = self._agents.get(i)
        if agent is None:
            return
        try:
            message = expect(part.message, Nav, Inbox, End)
        except MalformedMessage as error:
            agent.mailbox.reject(self._key, agent.loop.tick, error)
            return
        if isinstance(message, End):
            if agent.is_over(message):
                del self._agents[i]
            return
        self._running.at(i)
        try:
            answers = agent.take(self._key, message)
        except SystemExit as ended:
            self._lose(i, ended.code if isinstance(ended.code, int) else 1)
        except Exception:
            traceback.print_exc()
            self._lose(i, 1)
        else:
            for answer in answers:
                to = self._to_netem if isinstance(answer, (Transmission, Receipt)) else self._to_world
                to.append(BundlePart(i, encode(answer)))

    def _lose(self, i: int, status: int) -> None:
        del self._agents[i]
        self._note(encode(Ended(i, status)))
