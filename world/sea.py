"""The world's core: the true state of every vehicle, what its sensors measure, and its motion over one tick.

Vehicles touch each other only through the network, never through the water. So each has its own tick and may run ahead
of the others within a network round. Their order cannot change a bit. No clock, no I/O: a run is a function of the
configuration and the commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import isfinite
from typing import Any, cast

from netem.draws import normal, uniform
from netem.fault_kinds import WorldFaultKind
from netem.vehicle_clock import Clocks
from netem.wire.messages import WorldFault
from world.api import PlantConfig
from world.config import NavNoise, VehicleSetup, WorldConfig
from world.disturbance import GaussMarkov, disturbance, gust, purpose
from world.dynamics import Coefficients, State, coefficients, rk4_step
from world.errors import IntegrationError, WorldError
from world.navigation.config import Navigation, NavigationTrace
from world.navigation.navigator import Navigator
from world.navigation.trace_replay import ReplayedError
from world.plants.fenced_plant import FencedPlant
from world.vectors import Vec2, Vec3, Vec5, Vec6, plus

PURPOSE = "nav noise"
Measured = tuple[Vec5, Vec5, tuple[float, ...]]  # eta, nu, roll

Stages = tuple[tuple[Vec5, Vec5, Vec5], ...]  # the disturbance at start, middle and end of each RK4 step


def _purpose(fault: WorldFault) -> str:
    return f"fault {fault.id}"


class _Vehicle:
    """One vehicle: its constants, its tick, and its state there; its plant, if it is one, knows more than that."""

    __slots__ = ("k", "navigation", "plant", "setup", "state", "tau_max", "tick")

    def __init__(self, setup: VehicleSetup, config: WorldConfig) -> None:
        self.setup = setup
        self.k: Coefficients = coefficients(setup.params)
        self.tau_max: Vec3 = setup.tau_max
        self.tick: int = 0
        self.state: State = _initial(setup)
        self.plant: Any = None
        if setup.plant is not None:
            self.plant = FencedPlant(
                setup.plant, PlantConfig(setup.id, config.tick_ns / 1e9, config.seed, setup.params)
            )
            x, y, z, theta, psi, u, v, w, q, r = self.state
            phi, p = setup.plant.phi0, setup.plant.p0
            self.plant.start(0, (x, y, z, phi, theta, psi), (u, v, w, p, q, r))
            self.state = _plant_state(self.plant)
            t1, t2, t3 = self.tau_max
            l1, l2, l3 = self.plant.limits
            self.tau_max = min(t1, l1), min(t2, l2), min(t3, l3)
        self.navigation = navigation_of(setup.navigation, config.seed, setup.id, config.tick_ns, self.state)

    def take_over(self, before: _Vehicle) -> None:
        """Go on as another one did, which gives away its plant and its navigation if they are set up as ours are."""
        self.tick, self.state = before.tick, before.state
        if self.plant is not None:
            if before.plant is not None and self.setup.plant == before.setup.plant:
                self.plant.close()
                self.plant, before.plant = before.plant, None
            else:
                x, y, z, theta, psi, u, v, w, q, r = self.state
                phi, p = (0.0, 0.0) if before.plant is None else before.plant.roll
                self.plant.start(self.tick, (x, y, z, phi, theta, psi), (u, v, w, p, q, r))
                self.state = _plant_state(self.plant)
        if self.navigation is not None:
            if before.navigation is not None and self.setup.navigation == before.setup.navigation:
                self.navigation = before.navigation
            else:
                self.navigation.begin(self.tick, self.state)


class _Vehicles(dict[int, _Vehicle]):
    def __missing__(self, i: int) -> _Vehicle:
        raise WorldError(f"vehicle {i} is not in this world, which has {list(self)}")


class World:
    """Truth, sensors, actuators and integration of every vehicle of one run."""

    def __init__(self, config: WorldConfig) -> None:
        """Put every vehicle where it begins. Raises PluginError if a plant cannot be used; PlantError if it cannot be
        made or started.
        """
        self.config = config
        setups = sorted(config.vehicles, key=lambda setup: setup.id)
        self._vehicles = _Vehicles({setup.id: _Vehicle(setup, config) for setup in setups})
        self.notes: list[tuple[int, int, str]] = []  # (vehicle, tick, text) for a person; the reader clears it
        self.ids: tuple[int, ...] = tuple(self._vehicles)
        self._noise = None if config.noise.off else config.noise
        self.faults = config.faults
        self._held: dict[tuple[str, int], tuple[float, ...]] = {}  # (fault, vehicle): what froze or got stuck
        self._drifts: dict[str, GaussMarkov] = {}  # drifts of the sea (""), and of faults by id
        self._tick_s = config.tick_ns / 1e9
        self._h = config.tick_ns / 1e9 / config.substeps
        # Every vehicle feels the same disturbance and all pass the same ticks, some ahead of others.
        self._stage_forces = lru_cache(maxsize=4 * max(config.round_ticks, 8))(self._stage_forces_at)

    def tick(self, i: int) -> int:
        """Vehicle i is integrated up to this tick."""
        return self._vehicles[i].tick

    def state(self, i: int) -> tuple[Vec5, Vec5]:
        """True eta [m, rad] and nu [m/s, rad/s] of vehicle i at its tick."""
        x, y, z, theta, psi, u, v, w, q, r = self._vehicles[i].state
        return (x, y, z, theta, psi), (u, v, w, q, r)

    def position(self, i: int) -> Vec3:
        """True x, y, z [m, NED] of vehicle i at its tick."""
        state = self._vehicles[i].state
        return state[0], state[1], state[2]

    def pitch(self, i: int) -> Vec2:
        """True pitch theta [rad] of vehicle i at its tick, and how fast it changes [rad/s]: q, without roll."""
        vehicle = self._vehicles[i]
        if vehicle.plant is not None:
            return cast(Vec2, vehicle.plant.pitch)
        return vehicle.state[3], vehicle.state[8]

    def clock_error(self, i: int) -> tuple[float, ...]:
        """By how much the clock of vehicle i is ahead at its tick [s]; () while all clocks are right."""
        return () if self.clocks is None else (self.clocks.ahead_ns(i, self._vehicles[i].tick) / 1e9,)

    def of_plant(self, i: int) -> tuple[float, ...]:
        """True roll phi [rad] and roll rate p [rad/s] of vehicle i at its tick, and behind them what its plant reports;
        () of a vehicle without a plant, which cannot roll."""
        plant = self._vehicles[i].plant
        return () if plant is None else (*plant.roll, *plant.reported)

    def sense(self, i: int) -> Measured:
        """Eta [m, rad], nu [m/s, rad/s], roll (phi [rad], p [rad/s]; () without a plant) as vehicle i measures them."""
        eta, nu = self.state(i)
        vehicle = self._vehicles[i]
        measured: Measured = (eta, nu, () if vehicle.plant is None else vehicle.plant.roll)
        if vehicle.navigation is not None:
            measured = vehicle.navigation.belief(vehicle.state, measured[2])
        tick = vehicle.tick
        if self._noise is not None:
            measured = measure(measured, self._noise, self.config.seed, i, tick)
        if not self._faults:
            return measured
        for fault in self._active(i, tick):
            match fault.kind:
                case WorldFaultKind.NOISE:
                    extra = NavNoise(*fault.values)
                    measured = measure(measured, extra, self.config.seed, i, tick, _purpose(fault))
                case WorldFaultKind.BIAS:
                    # Twelve numbers, of which a vehicle without roll has no use for the last two.
                    measured = split([a + b for a, b in zip(_join(measured), fault.values, strict=False)])
                case WorldFaultKind.FREEZE:
                    measured = split(self._held.setdefault((fault.id, i), _join(measured)))
                case WorldFaultKind.DROPOUT:
                    known = self._held.get((fault.id, i))
                    if known is None or uniform(self.config.seed, _purpose(fault), i, tick) >= fault.values[0]:
                        self._held[fault.id, i] = _join(measured)
                    else:
                        measured = split(known)
        return measured

    def navigation(self, i: int) -> Navigator | ReplayedError | None:
        """Vehicle i's belief about itself, its covariance and its fixes; None: it knows where it is."""
        return self._vehicles[i].navigation

    def actuate(self, i: int, tau: tuple[float, ...]) -> Vec3:
        """The force and moments that the actuators of vehicle i apply for a command [N, N m]: within +-tau_max, and
        with the faults of the actuators. Raises WorldError if `tau` is not three finite numbers.
        """
        vehicle = self._vehicles[i]
        if len(tau) != 3 or not all(map(isfinite, tau)):
            raise WorldError(f"vehicle {i}, tick {vehicle.tick}: expected tau as three finite numbers, got {tau!r}")
        t1, t2, t3 = tau
        l1, l2, l3 = vehicle.tau_max
        applied = max(-l1, min(l1, t1)), max(-l2, min(l2, t2)), max(-l3, min(l3, t3))
        return self._with_actuator_faults(i, vehicle.tick, applied) if self._faults else applied

    def _with_actuator_faults(self, i: int, tick: int, tau: Vec3) -> Vec3:
        for fault in self._active(i, tick):
            match fault.kind:
                case WorldFaultKind.EFFICIENCY:
                    f1, f2, f3 = fault.values
                    tau = (f1 * tau[0], f2 * tau[1], f3 * tau[2])
                case WorldFaultKind.SATURATE:
                    l1, l2, l3 = fault.values
                    tau = max(-l1, min(l1, tau[0])), max(-l2, min(l2, tau[1])), max(-l3, min(l3, tau[2]))
                case WorldFaultKind.OFF:
                    tau = (0.0, 0.0, 0.0)
                case WorldFaultKind.STUCK:
                    t1, t2, t3 = self._held.setdefault((fault.id, i), tau)
                    tau = (t1, t2, t3)
        return tau

    def _active(self, i: int, tick: int) -> list[WorldFault]:
        near = self._near(tick // self.config.round_ticks)
        return [fault for fault in near if fault.active(tick) and fault.concerns(i)] if near else []

    @property
    def faults(self) -> tuple[WorldFault, ...]:
        """All faults of sensors, actuators and sea, ordered by their begin. A caller sets the whole list."""
        return self._faults

    @faults.setter
    def faults(self, faults: tuple[WorldFault, ...]) -> None:
        self._faults = faults
        m = self.config.round_ticks

        def near(number: int) -> tuple[WorldFault, ...]:
            begin, end = number * m, (number + 1) * m
            return tuple(f for f in faults if f.begin < end and (f.end is None or begin < f.end))

        # A long timeline has hundreds, of which a round sees one or two.
        self._near = lru_cache(maxsize=8)(near)
        self.clocks = Clocks.that_differ(self.config.clocks, faults, self.config.tick_ns)  # None: all are right

    def advance(self, i: int, tau: Vec3) -> None:
        """Integrate vehicle i alone to its next tick with `tau` [N, N m] held. Raises IntegrationError if the motion
        left the finite numbers, PlantError if its plant failed; the state then stays that of the tick before.
        """
        vehicle, config = self._vehicles[i], self.config
        if config.moored:
            vehicle.tick += 1
            return
        k, tick, state = vehicle.k, vehicle.tick, vehicle.state
        current = config.current
        if config.drift is not None:
            current = plus(current, self._drift("", *config.drift).at(tick))
        h = self._h
        forces = self._stage_forces(tick)
        if self._faults:
            current, forces = self._with_sea_faults(i, tick, current, forces)
        if vehicle.plant is not None:
            self._advance_plant(i, tau, current, forces)
            return
        try:
            for d in forces:
                state = rk4_step(k, state, tau, d, h, current)
        except (OverflowError, ValueError):
            # math.sin of an infinite angle is a ValueError, not a NaN.
            raise IntegrationError("the motion left the finite numbers", state[3], i, tick) from None
        if not isfinite(sum(state)):
            raise IntegrationError("the motion left the finite numbers", state[3], i, tick)
        if vehicle.navigation is not None:
            self._navigate(i, vehicle.navigation, state, current)
        vehicle.state = state
        vehicle.tick = tick + 1

    def _navigate(self, i: int, navigation: Navigator | ReplayedError, after: State, current: Vec3) -> None:
        """Let vehicle i measure what it does in a tick, in a current [m/s, NED]; `after` is its state at the next."""
        vehicle = self._vehicles[i]
        faults = self._active(i, vehicle.tick + 1) if self._faults else []
        phi = 0.0 if vehicle.plant is None else vehicle.plant.roll[0]
        try:
            navigation.step(vehicle.state, after, current, faults, phi)
        except (OverflowError, ValueError, ZeroDivisionError):
            raise IntegrationError("its navigation left the finite numbers", after[3], i, vehicle.tick) from None

    def _advance_plant(self, i: int, tau: Vec3, current: Vec3, forces: Stages) -> None:
        """The same for a vehicle that is a plant, which gets the disturbance at the middle of each step."""
        vehicle = self._vehicles[i]
        plant, tick = vehicle.plant, vehicle.tick
        wrenches: list[Vec6] = [(x, y, z, 0.0, m, n) for _, (x, y, z, m, n), _ in forces]
        plant.advance(tick, tau, current, wrenches, self._h)
        after = _plant_state(plant)
        if vehicle.navigation is not None:
            self._navigate(i, vehicle.navigation, after, current)
        vehicle.state = after
        vehicle.tick = tick + 1
        if plant.notes:
            self.notes += [(i, k, text) for k, text in plant.notes]
            plant.notes.clear()

    def _with_sea_faults(self, i: int, tick: int, current: Vec3, forces: Stages) -> tuple[Vec3, Stages]:
        """Current [m/s, NED] and disturbance [N, N m] with the faults of the sea added."""
        for fault in self._active(i, tick):
            if fault.kind == WorldFaultKind.CURRENT:
                x, y, z, *sigma, time_constant = fault.values
                current = plus(current, (x, y, z))
                if any(sigma):
                    drift = self._drift(fault.id, (sigma[0], sigma[1], sigma[2]), time_constant)
                    current = plus(current, drift.at(tick - fault.begin))
            elif fault.kind == WorldFaultKind.GUST:
                x, y, z, over_s = fault.values
                current = plus(current, gust((x, y, z), over_s, (tick - fault.begin) * self._tick_s))
            elif fault.kind == WorldFaultKind.WRENCH:
                w1, w2, w3, w4, w5 = fault.values
                start, middle, end = (
                    [(a + w1, b + w2, c + w3, d + w4, e + w5) for a, b, c, d, e in column]
                    for column in zip(*forces, strict=True)
                )
                forces = tuple(zip(start, middle, end, strict=True))
        return current, forces

    def _drift(self, name: str, sigma: Vec3, time_constant_s: float) -> GaussMarkov:
        if name not in self._drifts:
            self._drifts[name] = GaussMarkov(sigma, time_constant_s, self._tick_s, self.config.seed, purpose(name))
        return self._drifts[name]

    def paused(self, i: int, tick: int) -> bool:
        return bool(self._faults) and any(fault.kind == WorldFaultKind.PAUSE for fault in self._active(i, tick))

    def slow(self, i: int, tick: int) -> int:
        """How many ticks later than usual the command of vehicle i's agent for a tick takes effect."""
        if not self._faults:
            return 0
        return max((int(f.values[0]) for f in self._active(i, tick) if f.kind == WorldFaultKind.SLOW), default=0)

    def hold(self, i: int) -> None:
        """Let a tick pass without integrating vehicle i, whose motion diverged: it stays where it was."""
        self._vehicles[i].tick += 1

    @property
    def holds(self) -> bool:
        """Whether a plant holds something that it must end, such as a process."""
        return any(vehicle.plant is not None and vehicle.plant.holds for vehicle in self._vehicles.values())

    def close(self) -> None:
        """End what the plants hold; no vehicle is moved afterwards."""
        for plant in filter(None, (vehicle.plant for vehicle in self._vehicles.values())):
            plant.close()

    def take_over(self, before: World) -> None:
        """Go on from the world of another run of the same vehicles, which is not used afterwards. A plant or a
        navigator that is set up as it was there goes on as it is; another one begins with the motion of its vehicle.
        Raises PlantError if a plant cannot begin there.
        """
        for i, vehicle in self._vehicles.items():
            vehicle.take_over(before._vehicles[i])
        self._held = before._held
        before.close()

    def _stage_forces_at(self, tick: int) -> tuple[tuple[Vec5, Vec5, Vec5], ...]:
        config = self.config
        n = config.substeps
        t = tick * config.tick_ns / 1e9
        d = [disturbance(config.disturbance, t + j * 0.5 * self._h) for j in range(2 * n + 1)]
        return tuple((d[2 * j], d[2 * j + 1], d[2 * j + 2]) for j in range(n))


def _join(measured: Measured) -> tuple[float, ...]:
    eta, nu, roll = measured
    return (*eta, *nu, *roll)


def _plant_state(plant: Any) -> State:
    x, y, z, _, theta, psi = plant.pose
    u, v, w, _, q, r = plant.velocity
    return x, y, z, theta, psi, u, v, w, q, r


def _initial(setup: VehicleSetup) -> State:
    x, y, z, theta, psi = map(float, setup.eta0)
    u, v, w, q, r = map(float, setup.nu0)
    return x, y, z, theta, psi, u, v, w, q, r


def measure(true: Measured, noise: NavNoise, seed: int, vehicle: int, tick: int, purpose: str = PURPOSE) -> Measured:
    """The report of a vehicle's sensor at a tick: `true`, with white noise if there is some.

    `true` has three parts. The pose is x, y, z [m, NED], theta, psi [rad]. The velocity over ground is u, v, w [m/s,
    body], q, r [rad/s]. The roll is phi [rad], p [rad/s], or empty. The noise of a component is a function of (seed,
    purpose, vehicle, tick, component), so it does not depend on who was sensed before.
    """
    if noise.off:
        return true
    eta, nu, roll = true
    p, a, s, r = noise.position_m, noise.angle_rad, noise.velocity_mps, noise.rate_radps
    sigmas = (p, p, p, a, a, s, s, s, r, r, a, r)[: 10 + len(roll)]
    # A component without noise is not drawn: hashing costs more than the rest of the tick.
    return split(
        [
            value + sigma * normal(seed, purpose, vehicle, tick, component) if sigma else value
            for component, (value, sigma) in enumerate(zip(eta + nu + roll, sigmas, strict=True))
        ]
    )


def split(values: Sequence[float]) -> Measured:
    """Eta, nu and roll of the numbers of all three, one after the other."""
    x, y, z, theta, psi, u, v, w, q, r = values[:10]
    return (x, y, z, theta, psi), (u, v, w, q, r), tuple(values[10:])


def navigation_of(
    config: Navigation | None, seed: int, i: int, tick_ns: int, state: State
) -> Navigator | ReplayedError | None:
    """The navigation of vehicle i, from its true state at the start; None: the vehicle knows where it is."""
    if config is None:
        return None
    if isinstance(config, NavigationTrace):
        return ReplayedError(config, tick_ns)
    return Navigator(config, seed, i, tick_ns, state)
