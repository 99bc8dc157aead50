"""The agent's core: one sample of one vehicle's brain, from what it measured and heard to what it does.

No clock, no I/O, no randomness: what an agent answers depends on its configuration and on what it was given.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| eta, nu | own measured pose and velocity over ground | m, rad, m/s, rad/s | NED, body | (1) |
| pd = eta_1^d(t) + p_i | own desired position | m | NED | (11) |
| e, c | consensus error and its total weight | m, 1 | NED | (8), (18) |
| rho | virtual control | m/s | NED | (11) |
| tau | surge force, pitch and yaw moment within the actuator limits | N, N m | body | (35), (45) |
"""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import Any, NamedTuple, Protocol

from agents import backstepping
from agents.command import clip, direction_command, floor_speed
from agents.config import AgentConfig
from agents.consensus import consensus_error
from agents.controllers import build
from agents.errors import ControllerError
from agents.kinematics import earth_velocity
from agents.neighbours import Delivery, NeighbourTable
from agents.payload import StateMessage, encode
from agents.signals import Signal
from world.vehicle import Vec3, Vec5

GUIDANCE_SIGNALS = (
    Signal("guidance", "e_used", "m", 3, "consensus error from what the agent knows of its neighbours, NED"),
    Signal("guidance", "K", "1/s", 3, "diagonal of the virtual control gain in use"),
    Signal("guidance", "rho", "m/s", 3, "virtual control after its bounds, NED"),
    Signal("guidance", "u_cmd", "m/s", 1, "commanded speed after the floor"),
    Signal("guidance", "theta_cmd", "rad", 1, "commanded pitch of the velocity"),
    Signal("guidance", "psi_cmd", "rad", 1, "commanded course of the velocity"),
    Signal("guidance", "qp_status", "1", 1, "0 gain held, 1 solved, 2 no solution and gain held"),
    Signal("guidance", "neighbours_heard", "1", 1, "neighbours heard at least once"),
    Signal("guidance", "qp_failures", "1", 1, "optimisations without a solution since the start"),
    Signal("guidance", "payloads_rejected", "1", 1, "payloads refused by the codec since the start"),
)


class Nav(Protocol):
    """What the agent measures of its own vehicle at a tick."""

    @property
    def tick(self) -> int: ...
    @property
    def eta(self) -> tuple[float, ...]: ...
    @property
    def nu(self) -> tuple[float, ...]: ...


class Decision(NamedTuple):
    """The answer to one sample: tau within its limits [N, N m], and the values of `Agent.signals`."""

    tau: Vec3
    telemetry: tuple[float, ...]


class Step(NamedTuple):
    """A decision, and what to send to the neighbours: nothing between round ticks."""

    tau: Vec3
    telemetry: tuple[float, ...]
    payloads: tuple[bytes, ...]


class Agent:
    """The brain of one vehicle. Its "k = 0" is its own first sample, at whatever tick that is."""

    signals: tuple[Signal, ...] = GUIDANCE_SIGNALS + backstepping.SIGNALS

    def __init__(self, config: AgentConfig) -> None:
        self.config = config
        self._tick_s = config.tick_ns / 1e9
        self._neighbours = NeighbourTable(
            config.neighbours, config.extrapolation, config.reference.velocity, self._tick_s
        )
        self._guidance, self._tracking = build(config)
        self._last_tick: int | None = None
        self._held = (0.0, 0.0)  # theta_cmd, psi_cmd of the previous sample
        x, y, z = config.tau_max
        self._tau_limits: tuple[Vec3, Vec3] = ((-x, -y, -z), (x, y, z))

    def step(self, nav: Nav, deliveries: Iterable[Delivery]) -> Step:
        """One sample: what was heard is absorbed, the own state is sent on round ticks, tau is decided.

        Args:
            nav: own state at this tick.
            deliveries: what became due at this tick, ordered by (due_tick, sent_tick, src, seq).

        Raises:
            ControllerError: the measurement, the forces or the telemetry are not finite, or time went back.
        """
        payloads = self.transmit(nav) if nav.tick % self.config.round_ticks == 0 else ()
        tau, telemetry = self.decide(nav, deliveries)
        return Step(tau, telemetry, payloads)

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The payloads to every neighbour: own position and velocity over ground at this tick."""
        eta, nu = self._measured(nav)
        return (encode(StateMessage(self.config.id, nav.tick, eta[:3], earth_velocity(eta, nu))),)

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> Decision:
        """The same as `step` without the sending."""
        tick = nav.tick
        eta, nu = self._measured(nav)
        dt = self._elapsed(tick)
        self._neighbours.absorb(deliveries, tick)
        try:
            demand, telemetry = self._control(tick, dt, eta, nu)
        except (OverflowError, ValueError) as error:
            # math's way of saying that a number left its range, for instance the sine of infinity.
            raise ControllerError(self.config.id, tick, "arithmetic", str(error)) from error
        if not isfinite(sum(telemetry)):
            self._blame(tick, telemetry)
        self._last_tick = tick
        return Decision(clip(demand, *self._tau_limits), telemetry)

    def _control(self, tick: int, dt: float, eta: Vec5, nu: Vec5) -> tuple[Vec3, tuple[float, ...]]:
        config = self.config
        tracking = config.tracking
        if self._last_tick is None:
            self._held = eta[3:]
        heard = self._neighbours.heard(tick)
        e, c = consensus_error(eta[:3], self._desired(tick), config.reference_weight, heard)
        rho = self._guidance.step(tick, dt, e, c, earth_velocity(eta, nu))
        u_cmd, theta_cmd, psi_cmd = direction_command(rho, *self._held, tracking.rho_eps)
        self._held = (theta_cmd, psi_cmd)
        u_cmd = floor_speed(u_cmd, nu[1], nu[2], tracking.u_floor)
        demand, control = self._tracking.step(eta, nu, (u_cmd, theta_cmd, psi_cmd), dt)
        K = self._guidance.K
        counts = (
            float(self._guidance.qp_status),
            float(len(heard)),
            float(self._guidance.failures),
            float(self._neighbours.rejected),
        )
        return demand, (*e, *K, *rho, u_cmd, theta_cmd, psi_cmd, *counts, *control)

    def _desired(self, tick: int) -> Vec3:
        """pd_i(t) = eta_1^d(t) + p_i [m, NED]."""
        t = tick * self.config.tick_ns / 1e9
        x, y, z = self.config.reference.start
        vx, vy, vz = self.config.reference.velocity
        px, py, pz = self.config.offset
        return x + vx * t + px, y + vy * t + py, z + vz * t + pz

    def _measured(self, nav: Nav) -> tuple[Vec5, Vec5]:
        x, y, z, theta, psi = nav.eta
        u, v, w, q, r = nav.nu
        if not isfinite(x + y + z + theta + psi + u + v + w + q + r):
            raise ControllerError(self.config.id, nav.tick, "the measured state", (nav.eta, nav.nu))
        return (x, y, z, theta, psi), (u, v, w, q, r)

    def _elapsed(self, tick: int) -> float:
        """Time since the previous sample [s]; Ts at the first, more after samples that were missed."""
        last = self._last_tick
        if last is None:
            return self._tick_s
        if tick <= last:
            raise ControllerError(self.config.id, tick, "the tick of the sample before", last)
        return (tick - last) * self._tick_s

    def _blame(self, tick: int, telemetry: tuple[float, ...]) -> None:
        """Raise for the first telemetry value that is not finite, if there is one."""
        position = 0
        for signal in self.signals:
            values = telemetry[position : position + signal.width]
            if not all(map(isfinite, values)):
                raise ControllerError(self.config.id, tick, f"{signal.group}.{signal.name}", values)
            position += signal.width

    def counters(self) -> dict[str, int]:
        """How many payloads were accepted or refused by cause, and how many optimisations failed."""
        return {**self._neighbours.counters, "qp_failures": self._guidance.failures}

    def state(self) -> dict[str, Any]:
        """Everything that the next sample depends on, as plain MessagePack values."""
        return {
            "last_tick": self._last_tick,
            "held": list(self._held),
            "neighbours": self._neighbours.state(),
            "guidance": self._guidance.state(),
            "tracking": self._tracking.state(),
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Continue from `state()` of an agent with the same configuration."""
        theta, psi = values["held"]
        self._last_tick = values["last_tick"]
        self._held = (theta, psi)
        self._neighbours.restore(values["neighbours"])
        self._guidance.restore(values["guidance"])
        self._tracking.restore(values["tracking"])
