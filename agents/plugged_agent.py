"""A user's whole agent behind a fence."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

from agents.brain import Brain
from agents.config import AgentConfig, Law
from agents.errors import ControllerError
from agents.laws.velocity_command import clip
from agents.own_time import deliveries_to_own_clock, to_own_clock
from agents.plugins.laws import law_fence, load
from agents.sample import Decision
from agents.speech import Speech, usable
from netem.wire.messages import Delivery, Nav
from world.plugins.fence import show_value
from world.vectors import Vec3

MAX_PAYLOAD_BYTES = 40_000  # the payloads of one round; the transport carries 48 kB in a message


class PluggedAgent(Brain):
    """A user's whole agent: it gets raw payloads, and decides what it sends."""

    def __init__(self, config: AgentConfig, law: Law) -> None:
        super().__init__(config)
        self._fence = law_fence(config, law, self._notes)
        agent_class = load("agent", law)
        self._user = self._fence.make(agent_class, config, law.parameters)
        self._speech = Speech() if hasattr(agent_class, "take_said") else None

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The payloads to every neighbour; none once it has failed."""
        if self._failed:
            return ()
        fence, method = self._fence, self._user.transmit
        try:
            payloads = fence.call(nav.tick, method, to_own_clock(nav, self.config.tick_ns))
            if not isinstance(payloads, (list, tuple)) or not all(isinstance(p, bytes) for p in payloads):
                raise fence.wrong(nav.tick, method, f"returned {show_value(payloads)}: expected a list of bytes")
            if (size := sum(map(len, payloads))) > MAX_PAYLOAD_BYTES:
                text = f"returned {size} bytes: at most {MAX_PAYLOAD_BYTES} fit into a round"
                raise fence.wrong(nav.tick, method, text)
        except ControllerError as error:
            self._coast(error)
            return ()
        return tuple(payloads)

    def decide(self, nav: Nav, deliveries: Sequence[Delivery]) -> Decision:
        """Forces from what it measures and receives; none once it has failed."""
        tick = nav.tick
        self._elapsed(tick)
        self._last_tick = tick
        demand: Vec3 = (0.0, 0.0, 0.0)
        telemetry = (nan,) * self.layout.size
        works = not self._failed
        if works:
            fence, method = self._fence, self._user.decide
            try:
                own = to_own_clock(nav, self.config.tick_ns)
                answer = fence.call(tick, method, own, deliveries_to_own_clock(list(deliveries), own))
                if not isinstance(answer, tuple) or len(answer) != 2:
                    text = f"returned {show_value(answer)}: expected ((tau1, tau2, tau3), telemetry)"
                    raise fence.wrong(tick, method, text)
                demand = fence.vector(tick, method, "(tau1, tau2, tau3)", answer[0])
                telemetry = fence.telemetry(tick, method, self.layout.control, answer[1])
            except ControllerError as error:
                self._coast(error)
                demand = (0.0, 0.0, 0.0)
        if self._speech is None:
            return Decision(clip(demand, *self._tau_limits), telemetry)
        if works:
            self._listen(tick, self._speech)  # also when it has just failed: it may say why
        return Decision(clip(demand, *self._tau_limits), telemetry, self._speech.take())

    def _listen(self, tick: int, speech: Speech) -> None:
        fence, method = self._fence, self._user.take_said
        try:
            lines = fence.call(tick, method)
            if not isinstance(lines, (list, tuple)) or not all(map(usable, lines)):
                raise fence.wrong(
                    tick, method, f"returned {show_value(lines)}: expected a list of Said(ns, stream, text)"
                )
        except ControllerError as error:
            self._coast(error)
        else:
            speech.put(lines)

    def counters(self) -> dict[str, int]:
        """None: what a user's agent counts is in its telemetry."""
        return {}
