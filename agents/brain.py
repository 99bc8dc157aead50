"""The common part of both kinds of agent: limits, the order of ticks, and the consequences if a law fails."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from agents.config import AgentConfig
from agents.controllers import layout
from agents.errors import ControllerError
from agents.sample import Decision, Step
from agents.signals import SignalLayout
from netem.wire.messages import Delivery, Nav
from world.vectors import Vec3, Vec5


class Brain:
    """The work of every agent, with any laws."""

    def __init__(self, config: AgentConfig) -> None:
        self.config = config
        self.layout: SignalLayout = layout(config)
        self._tick_s = config.tick_ns / 1e9
        self._last_tick: int | None = None
        self._failed = False
        self._notes: list[tuple[int, str]] = []
        x, y, z = config.tau_max
        self._tau_limits: tuple[Vec3, Vec3] = ((-x, -y, -z), (x, y, z))

    def step(self, nav: Nav, deliveries: Sequence[Delivery]) -> Step:
        """Answer one sample: payloads on round ticks, and the decision. Raises as `decide`."""
        payloads = self.transmit(nav) if nav.tick % self.config.round_ticks == 0 else ()
        tau, telemetry, _ = self.decide(nav, deliveries)
        return Step(tau, telemetry, payloads)

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        raise NotImplementedError

    def decide(self, nav: Nav, deliveries: Sequence[Delivery]) -> Decision:
        """The same as `step` without the payloads."""
        raise NotImplementedError

    def take_notes(self) -> list[tuple[int, str]]:
        """(tick, text) of what a person should know since the last call."""
        if not self._notes:
            return []
        taken = self._notes.copy()
        self._notes.clear()
        return taken

    def _measured(self, nav: Nav) -> tuple[Vec5, Vec5]:
        """Measured eta [m, rad, NED] and nu [m/s, rad/s, body], checked to be finite."""
        x, y, z, theta, psi = nav.eta
        u, v, w, q, r = nav.nu
        if not isfinite(x + y + z + theta + psi + u + v + w + q + r):
            raise ControllerError(self.config.id, nav.tick, f"the measured state is {(nav.eta, nav.nu)!r}")
        return (x, y, z, theta, psi), (u, v, w, q, r)

    def _elapsed(self, tick: int) -> float:
        """Time since the previous sample [s]; Ts at the first, more after samples that were missed."""
        last = self._last_tick
        if last is None:
            return self._tick_s
        if tick <= last:
            raise ControllerError(self.config.id, tick, f"the tick of the sample before was {last}")
        return (tick - last) * self._tick_s

    def _coast(self, error: ControllerError) -> None:
        if self.config.on_error != "coast":
            raise error
        self._failed = True
        where = f" ({error.where})" if error.where else ""
        self._notes.append((error.tick, f"{error.problem}{where}; it is not called again, the vehicle coasts"))

    def _check(self, tick: int, demand: Vec3, telemetry: tuple[float, ...]) -> None:
        if isfinite(sum(telemetry, 0.0) + sum(demand, 0.0)):
            return
        for group, signal, place in self.layout.signals():
            values = telemetry[place]
            if not all(map(isfinite, values)):
                raise ControllerError(self.config.id, tick, f"{group}.{signal.name} is {values!r}")
        if not all(map(isfinite, demand)):
            raise ControllerError(self.config.id, tick, f"tau is {demand!r}")
