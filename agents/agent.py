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

from collections.abc import Iterable, Mapping, Sequence
from math import nan

from agents.brain import Brain
from agents.codecs import codec
from agents.compact import OutOfRange
from agents.config import AgentConfig
from agents.controllers import Notes, build
from agents.errors import ControllerError
from agents.laws.kinematics import earth_velocity
from agents.laws.velocity_command import clip, consensus_error
from agents.localization.localizer import Localizer, Navigated
from agents.neighbours import NeighbourTable, own_time
from agents.offset import Offset
from agents.payload import StateMessage
from agents.sample import Decision, NeighbourState, Sample
from agents.trajectory import Motion
from netem.wire.messages import Delivery, Nav
from world.vectors import Vec3


def motion_from_neighbours(
    position: Vec3, heard: Iterable[NeighbourState], offsets: Mapping[int, Offset], t: float
) -> Motion:
    """The desired motion of a vehicle that does not know the reference, computed from its neighbours' states.

    | symbol | meaning | unit | frame |
    |---|---|---|---|
    | a_ij | weight of neighbour j | 1 | - |
    | Delta_ij(t), Delta_ij'(t) | desired offset p_i - p_j at the own time t [s], and its rate | m, m/s | NED |
    | pos_j, vel_j | neighbour j's position, extrapolated to now, and its velocity when it sent | m, m/s | NED |

    The desired position is the weighted mean of pos_j + Delta_ij over the neighbours heard so far, whose state is not
    outdated. The desired velocity is the weighted mean of vel_j + Delta_ij'. If the sum of the weights is 0, the
    desired position is the vehicle's own position and the desired velocity is 0.

    Along a directed chain this is stable for every delay. Over links both ways the linear loop is unstable at every
    gain, and the fleet swings by half a metre. A better estimator is a separate protocol.
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


class ByReference:
    """The desired motion of a vehicle that knows the reference."""

    def __init__(self, config: AgentConfig, neighbours: NeighbourTable, notes: Notes) -> None:
        self._config, self._neighbours, self._notes = config, neighbours, notes

    def place(self, position: Vec3, heard: tuple[NeighbourState, ...], t: float) -> Motion:
        """Where to be [m, NED] and how to move [m/s, NED] at time t [s] of the own clock."""
        return self._config.desired(t)

    def weight(self, tick: int, now: int) -> float:
        """b_i [1] of this place at a tick of simulated time, which is `now` by the own clock."""
        return self._config.reference_weight


class ByNeighbours(ByReference):
    """The desired motion of a vehicle that does not know the reference."""

    def __init__(self, config: AgentConfig, neighbours: NeighbourTable, notes: Notes) -> None:
        super().__init__(config, neighbours, notes)
        self._offsets = {neighbour.id: neighbour.offset for neighbour in config.neighbours}

    def place(self, position: Vec3, heard: tuple[NeighbourState, ...], t: float) -> Motion:
        return motion_from_neighbours(position, heard, self._offsets, t)


class OnStandby(ByReference):
    """A vehicle that follows the reference itself while it hears none of the neighbours that it stands by for."""

    def __init__(self, config: AgentConfig, neighbours: NeighbourTable, notes: Notes) -> None:
        super().__init__(config, neighbours, notes)
        self._leads = False
        self._first_tick: int | None = None  # since when it could have heard neighbours
        self._standby_ticks = round(config.standby_after_s / (config.tick_ns / 1e9))

    def weight(self, tick: int, now: int) -> float:
        config = self._config
        if self._first_tick is None:
            self._first_tick = now
        newest = self._neighbours.newest(config.standby_for)
        since = self._first_tick if newest is None else max(newest, self._first_tick)
        leads = now - since > self._standby_ticks
        if leads != self._leads:
            self._leads = leads
            who = ", ".join(map(str, config.standby_for))
            after = config.standby_after_s
            said = f"it has not heard {who} for {after:g} s and" if leads else f"it hears {who} again and no longer"
            self._notes.append((tick, f"{said} follows the reference itself"))
        return 1.0 if leads else config.reference_weight


class Agent(Brain):
    """The core of one vehicle's agent. Its "k = 0" is its own first sample, at whatever tick that is."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        localizer = Localizer(config) if config.codec == "located" else None
        self._localizer = localizer or Navigated()
        self._codec = codec(config, localizer)
        self._out_of_range = False  # whether a state did not fit into the payload
        self._neighbours = NeighbourTable(config, self._codec)
        goal = OnStandby if config.standby_for else ByNeighbours if config.reference is None else ByReference
        self._goal: ByReference = goal(config, self._neighbours, self._notes)
        self._controller = build(config, self._notes, self._neighbours)
        self._seed = f"{config.seed}/controller/{config.id}/"

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The payloads to every neighbour: own position and velocity over ground at this tick, and the own time."""
        nav = self._localizer.locate(nav)
        eta, nu = self._measured(nav)
        now, _, _ = own_time(nav, self.config.tick_ns)
        message = StateMessage(self.config.id, now, eta[:3], earth_velocity(eta, nu, nav.roll[0] if nav.roll else 0.0))
        try:
            return (self._codec.encode(message),)
        except OutOfRange as error:
            if not self._out_of_range:
                self._out_of_range = True
                text = f"a state that the {self.config.codec} payload cannot hold is not sent: {error}"
                self._notes.append((nav.tick, text))
            return ()

    def decide(self, nav: Nav, deliveries: Sequence[Delivery], course: Motion | None = None) -> Decision:
        """Absorb the deliveries of this tick, ordered by (due_tick, sent_tick, src, seq), and decide the forces.
        `course`: where to be and how to move at this sample, alone; None: in formation. Raises ControllerError if the
        measurement is not finite, time went back, or a law failed and `on_error` is not coast.
        """
        nav = self._localizer.absorb(nav, deliveries)
        tick = nav.tick
        now, t, ahead = own_time(nav, self.config.tick_ns)
        eta, nu = self._measured(nav)
        dt = self._elapsed(tick)
        self._neighbours.absorb(deliveries, now, ahead)
        heard = self._neighbours.states_at(now)
        if course is not None:
            desired = course
            e, c = consensus_error(eta[:3], desired.position, 1.0, ())
        else:
            desired = self._goal.place(eta[:3], heard, t)
            e, c = consensus_error(eta[:3], desired.position, self._goal.weight(tick, now), heard)
        known = (*e, float(len(heard)), float(self._neighbours.rejected), *self._localizer.telemetry())
        velocity = earth_velocity(eta, nu, nav.roll[0] if nav.roll else 0.0)
        seed = f"{self._seed}{tick}"
        sample = Sample(tick, t, dt, eta, nu, velocity, desired, heard, e, c, seed, nav.roll, nav.belief)
        demand, values = self._control(sample, known)
        self._last_tick = tick
        low, high = self._tau_limits
        return Decision(clip(demand, low, high), known + values)

    def _control(self, sample: Sample, known: tuple[float, ...]) -> tuple[Vec3, tuple[float, ...]]:
        """Forces [N, N m] before the limits, and telemetry beside what is known; zero and NaN once a law failed."""
        if not self._failed:
            try:
                demand, values = self._controller.step(sample)
                self._check(sample.tick, demand, known + values)
                return demand, values
            except (OverflowError, ValueError) as error:
                # What math raises when a number left its range, for instance the sine of infinity.
                failure = ControllerError(self.config.id, sample.tick, f"arithmetic: {error}")
                failure.__cause__ = error
                self._coast(failure)
            except ControllerError as error:
                self._coast(error)
        return (0.0, 0.0, 0.0), (nan,) * (self.layout.size - len(known))

    def counters(self) -> dict[str, int]:
        """How many payloads were accepted or refused by cause, and how many optimisations failed."""
        return {**self._neighbours.counters, **self._controller.counters()}
