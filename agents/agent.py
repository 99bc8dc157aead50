"""The core of an agent with our payload: from what a vehicle measured and received to its forces and its message.

No clock of its own, no I/O, no randomness: an answer depends on the configuration and on the samples so far. The nav
carries the time by the clock of its vehicle. Samples come with simulated time, whatever that clock shows.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| eta, nu | own measured pose and velocity over ground | m, rad, m/s, rad/s | NED, body | (1) |
| pd = eta_1^d(t) + p_i | own desired position | m | NED | (11) |
| e, c | consensus error and its total weight | m, 1 | NED | (8), (18) |
| tau | surge force, pitch and yaw moment within the actuator limits | N, N m | body | (35), (45) |
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import nan
from typing import Any

from agents import compact
from agents.brain import Brain
from agents.config import AgentConfig, Offset
from agents.controllers import build
from agents.errors import ControllerError
from agents.laws.kinematics import earth_velocity
from agents.laws.velocity_command import clip, consensus_error
from agents.localization import payload as located
from agents.localization.localizer import Localizer
from agents.neighbours import AHEAD_S, NeighbourTable
from agents.payload import StateMessage, encode
from agents.sample import Decision, NeighbourState, Sample
from agents.trajectory import Motion
from netem.wire.messages import Delivery, Nav
from world.vectors import Vec3

# --- following
# The desired motion of a vehicle that does not know the reference, computed from its neighbours' states.
#
# | symbol | meaning | unit | frame |
# |---|---|---|---|
# | a_ij | weight of neighbour j | 1 | - |
# | Delta_ij(t), Delta_ij'(t) | desired offset p_i - p_j, and its rate of change | m, m/s | NED |
# | pos_j, vel_j | neighbour j's position, extrapolated to now, and its velocity when it sent | m, m/s | NED |
#
# The desired position is the weighted mean of pos_j + Delta_ij over the neighbours j. The desired velocity is the
# weighted mean of vel_j + Delta_ij'. If the sum of the weights is 0 (no neighbour heard yet, or all dropped), the
# desired position is the vehicle's own position and the desired velocity is 0.


def followed(position: Vec3, heard: Iterable[NeighbourState], offsets: Mapping[int, Offset], t: float) -> Motion:
    """The desired position and velocity of a vehicle, from the states of the neighbours that it has heard.

    Args:
        position: its own position [m, NED].
        heard: the neighbours heard so far. Neighbours with an outdated state are left out.
        offsets: Delta_ij [m, NED] of each neighbour in `heard`, by its number j.
        t: time by the vehicle's clock [s].

    Returns:
        Position [m, NED] and velocity [m/s, NED].
    """
    total = x = y = z = vx = vy = vz = 0.0
    for j, a, (ox, oy, oz), (px, py, pz), (ux, uy, uz), _, _, _ in heard:
        offset = offsets[j]
        dx, dy, dz = offset.at(t).velocity if offset.changes else (0.0, 0.0, 0.0)
        total += a
        x += a * (px + ox)
        y += a * (py + oy)
        z += a * (pz + oz)
        vx += a * (ux + dx)
        vy += a * (uy + dy)
        vz += a * (uz + dz)
    if total == 0.0:
        return Motion(position, (0.0, 0.0, 0.0))
    return Motion((x / total, y / total, z / total), (vx / total, vy / total, vz / total))


class Agent(Brain):
    """The core of one vehicle's agent. Its "k = 0" is its own first sample, at whatever tick that is."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self._neighbours = NeighbourTable(
            config.neighbours,
            config.extrapolation,
            config.reference,
            config.offset,
            self._tick_s,
            config.age_cap_s,
            config.drop_after_s,
            config.codec,
            config.round_ticks,
        )
        self._controller = build(config, self._notes, self._neighbours)
        self._seed = f"{config.seed}/controller/{config.id}/"
        self._offsets = {neighbour.id: neighbour.offset for neighbour in config.neighbours}
        self._leads = False
        self._first_tick: int | None = None  # of an agent on standby: since when it could have heard neighbours
        self._standby_ticks = round(config.standby_after_s / self._tick_s)
        self._ahead_ticks = round(AHEAD_S / self._tick_s)
        # Without `localization` it has the navigator's position, and knows whether that had a fix of late.
        self._localizer = Localizer(config) if config.codec == "located" else None
        self._out_of_range = False  # whether a state did not fit into the compact payload
        self.course: Motion | None = None  # where to be and how to move at the next sample, alone; None: in formation

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The payloads to every neighbour: own position and velocity over ground at this tick, and the own time."""
        if self._localizer is not None:
            nav = self._localizer.located(nav)
        eta, nu = self._measured(nav)
        phi = nav.roll[0] if nav.roll else 0.0
        now = nav.tick if nav.clock_ns is None else nav.clock_ns // self.config.tick_ns
        message = StateMessage(self.config.id, now, eta[:3], earth_velocity(eta, nu, phi))
        if self.config.codec == "full":
            return (encode(message),)
        try:
            if self._localizer is not None:
                return (located.encode(self._localizer.message(message)),)
            return (compact.encode(message, self.config.round_ticks),)
        except compact.OutOfRange as error:
            if not self._out_of_range:
                self._notes.append(
                    (nav.tick, f"a state that the {self.config.codec} payload cannot hold is not sent: {error}")
                )
            self._out_of_range = True
            return ()

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> Decision:
        """Absorb what is due at this tick and decide the forces.

        Args:
            nav: own state at this tick.
            deliveries: what became due at this tick, ordered by (due_tick, sent_tick, src, seq).

        Raises:
            ControllerError: the measurement is not finite, time went back, or a law failed and `on_error` is not coast.
        """
        if self._localizer is not None:
            deliveries = list(deliveries)
            nav = self._localizer.absorb(nav, deliveries)
        tick = nav.tick
        config = self.config
        eta, nu = self._measured(nav)
        dt = self._elapsed(tick)
        if nav.clock_ns is None:
            now, t, ahead = tick, tick * config.tick_ns / 1e9, 0
        else:  # the vehicle's own time; its samples still come with simulated time
            now, t, ahead = nav.clock_ns // config.tick_ns, nav.clock_ns / 1e9, self._ahead_ticks
        self._neighbours.absorb(deliveries, now, ahead)
        heard = self._neighbours.heard(now)
        if self.course is not None:
            desired = self.course
            e, c = consensus_error(eta[:3], desired.position, 1.0, ())
        else:
            if config.reference is None:
                desired = followed(eta[:3], heard, self._offsets, t)
            else:
                desired = config.desired(t)
            b = self._standby_weight(tick, now) if config.standby_for else config.reference_weight
            e, c = consensus_error(eta[:3], desired.position, b, heard)
        known: tuple[float, ...] = (*e, float(len(heard)), float(self._neighbours.rejected))
        if self._localizer is not None and config.localization is not None:
            known = (*known, *self._localizer.telemetry())
        demand: Vec3 = (0.0, 0.0, 0.0)
        telemetry: tuple[float, ...] = known
        if not self._failed:
            seed = f"{self._seed}{tick}"
            velocity = earth_velocity(eta, nu, nav.roll[0] if nav.roll else 0.0)
            sample = Sample(tick, t, dt, eta, nu, velocity, desired, heard, e, c, seed, nav.roll, nav.belief)
            try:
                demand, values = self._control(sample)
                telemetry = known + values
                self._check(tick, demand, telemetry)
            except ControllerError as error:
                self._coast(error)
                demand = (0.0, 0.0, 0.0)
        if self._failed:
            telemetry = known + (nan,) * (self.layout.size - len(known))
        self._last_tick = tick
        low, high = self._tau_limits
        return Decision(clip(demand, low, high), telemetry)

    def _standby_weight(self, tick: int, now: int) -> float:
        """b_i [1] of an agent on standby: 1 while it has heard none of the neighbours that it stands by for."""
        if self._first_tick is None:
            self._first_tick = now
        newest = self._neighbours.newest(self.config.standby_for)
        since = self._first_tick if newest is None else max(newest, self._first_tick)
        leads = now - since > self._standby_ticks
        if leads != self._leads:
            self._leads = leads
            who = ", ".join(map(str, self.config.standby_for))
            after = self.config.standby_after_s
            said = f"it has not heard {who} for {after:g} s and" if leads else f"it hears {who} again and no longer"
            self._notes.append((tick, f"{said} follows the reference itself"))
        return 1.0 if leads else self.config.reference_weight

    def _control(self, sample: Sample) -> tuple[Vec3, tuple[float, ...]]:
        """Forces [N, N m] before the limits, and telemetry. If arithmetic fails, the error names vehicle and tick."""
        try:
            return self._controller.step(sample)
        except (OverflowError, ValueError) as error:
            # What math raises when a number left its range, for instance the sine of infinity.
            raise ControllerError(self.config.id, sample.tick, f"arithmetic: {error}") from error

    def counters(self) -> dict[str, int]:
        """How many payloads were accepted or refused by cause, and how many optimisations failed."""
        return {**self._neighbours.counters, **self._controller.counters()}

    def state(self) -> dict[str, Any]:
        """Everything that the next sample depends on, as plain MessagePack values."""
        more = {"standby": [self._first_tick, self._leads]} if self.config.standby_for else {}
        if self._localizer is not None:
            more["localizer"] = self._localizer.state()
        return {
            "last_tick": self._last_tick,
            "failed": self._failed,
            "unsaid": self._out_of_range,
            "neighbours": self._neighbours.state(),
            "controller": self._controller.state(),
            **more,
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Continue from `state()` of an agent with the same configuration."""
        self._last_tick = values["last_tick"]
        self._failed = values["failed"]
        self._out_of_range = values["unsaid"]
        self._neighbours.restore(values["neighbours"])
        self._controller.restore(values["controller"])
        if self.config.standby_for:
            self._first_tick, self._leads = values.get("standby", (None, False))
        if self._localizer is not None and "localizer" in values:  # not in the memory of a run without
            self._localizer.restore(values["localizer"])
