"""The measurements of a vehicle's instruments: heading sensor, gyros, DVL, pressure sensor, and fixes of its position.

| symbol | meaning | unit |
|---|---|---|
| psi + b + w + n | heading sensor: bias, random walk of the bias, noise of the sample | rad |
| q + g + n | gyro on each axis: bias; noise that makes an angle random walk | rad/s |
| (1 + s) v + n | DVL: scale error, noise of the sample; v over ground, or through the water | m/s |
| z + b + n | pressure sensor: bias, noise of the sample | m |

Between two samples of the DVL and of the pressure sensor the accelerometers carry what was measured on: the error stays
that of the sample. A bias is drawn once per run and vehicle. Each draw is a pure function of (seed, vehicle, tick,
purpose), so the vehicles may move in any order.

A fix of the horizontal position comes by GPS near the surface, by USBL or LBL within reach of the beacons. It is
measured at one tick and used some ticks later, as a measurement of where the vehicle was then. The noise on each axis
is sqrt(noise^2 + (growth * distance)^2).

Faults take samples of instruments and fixes away, bias them, or let them jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin, sqrt

from netem.draws import normal, uniform
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import Fix, WorldFault
from world.navigation.config import DeadReckoning, FixSource
from world.navigation.filter import BOTTOM, LOST, WATER, NavigationFilter
from world.vectors import Vec3

PURPOSE = "navigation"
NO_FAULTS: Sequence[WorldFault] = ()


def is_sample_lost(fault: WorldFault, seed: int, i: int, tick: int, source: int = 0) -> bool:
    """Whether a fault takes the sample of a tick; the probability is the first of its numbers."""
    chance = fault.values[0]
    return chance >= 1.0 or (chance > 0.0 and uniform(seed, _purpose(fault, "lost"), i, tick, source) < chance)


def jumps(fault: WorldFault, seed: int, i: int, tick: int, axes: int, source: int = 0) -> list[float]:
    """How far off a fault puts the sample of a tick on each axis; its last two numbers are sigma and probability."""
    sigma, chance = fault.values[-2:]
    if sigma == 0.0 or (chance < 1.0 and uniform(seed, _purpose(fault, "jumps"), i, tick, source) >= chance):
        return [0.0] * axes
    return [sigma * normal(seed, _purpose(fault, "jump"), i, tick, source, axis) for axis in range(axes)]


def _purpose(fault: WorldFault, what: str) -> str:
    return f"fault {fault.id} {what}"


def due(tick: int, tick_ns: int, period_ns: int) -> bool:
    """Whether a sample is due at a tick: the first at or after each multiple of its period."""
    return tick * tick_ns // period_ns > (tick - 1) * tick_ns // period_ns


class Instruments:
    def __init__(self, config: DeadReckoning, seed: int, i: int, tick_ns: int) -> None:
        grade = config.grade
        self._config, self._seed, self._i, self._tick_ns = config, seed, i, tick_ns
        rates = (grade.heading_rate, grade.gyro_rate, grade.dvl_rate, grade.depth_rate)
        self._heading_ns, self._gyro_ns, self._dvl_ns, self._depth_ns = (max(1, round(1e9 / rate)) for rate in rates)
        self._heading_s: float = max(self._heading_ns, tick_ns) / 1e9  # the time from sample to sample [s]
        self._gyro_s: float = max(self._gyro_ns, tick_ns) / 1e9
        # What stays for the whole run.
        self._heading_bias: float = self._draw(grade.heading_bias, "heading bias")
        self.gyro_bias: list[float] = [self._draw(grade.gyro_bias, "gyro bias", axis) for axis in range(3)]
        self.scale: float = 1.0 + self._draw(grade.dvl_scale, "dvl scale")
        self._depth_bias: float = self._draw(grade.depth_bias, "depth bias")
        self.tilt: list[float] = [self._draw(grade.tilt, "tilt", axis) for axis in range(2)]  # pitch, roll
        # What lasts to the next sample.
        self._walk: float = 0.0
        self.gyro: list[float] = list(self.gyro_bias)  # errors of yaw, pitch and roll rate
        self.dvl: list[float] = [0.0, 0.0, 0.0]  # errors of the velocity, body
        self.depth: float = self._depth_sample(0)
        self.mode: int = BOTTOM
        self.held: list[float] = [0.0, 0.0, 0.0]  # the last velocity that was measured [m/s, body]

    def heading(self, tick: int, psi: float, faults: Sequence[WorldFault] = NO_FAULTS) -> float | None:
        """A sample of the heading sensor [rad]; None: none at this tick."""
        if tick and not due(tick, self._tick_ns, self._heading_ns):
            return None
        grade = self._config.grade
        if tick:
            self._walk += self._draw(grade.heading_walk * sqrt(self._heading_s), "heading walk", tick)
        measured = psi + self._heading_bias + self._walk + self._draw(grade.heading_noise, "heading", tick)
        for fault in faults:
            if fault.kind == WorldFaultKind.COMPASS:
                if is_sample_lost(fault, self._seed, self._i, tick):
                    return None
                measured += fault.values[1] + jumps(fault, self._seed, self._i, tick, 1)[0]
        return measured

    def turn_rates(self, tick: int) -> None:
        """Draw new errors of the gyros, if it is time."""
        if not due(tick, self._tick_ns, self._gyro_ns):
            return
        sigma = self._config.grade.gyro_walk / sqrt(self._gyro_s)
        self.gyro = [bias + self._draw(sigma, "gyro", tick, axis) for axis, bias in enumerate(self.gyro_bias)]

    def velocity(self, tick: int, depth: float, faults: Sequence[WorldFault] = NO_FAULTS) -> bool:
        """Draw new errors of the DVL, and see what it sees, if it is time. `depth`: of the vehicle [m]."""
        if not due(tick, self._tick_ns, self._dvl_ns):
            return False
        config = self._config
        sees = config.bottom is None or config.bottom - depth <= config.grade.dvl_altitude
        self.mode = BOTTOM if sees else WATER
        self.dvl = [self._draw(config.grade.dvl_noise, "dvl", tick, axis) for axis in range(3)]
        for fault in faults:
            if fault.kind == WorldFaultKind.DVL:
                if is_sample_lost(fault, self._seed, self._i, tick):
                    self.mode = LOST
                off = jumps(fault, self._seed, self._i, tick, 3)
                for axis in range(3):
                    self.dvl[axis] += fault.values[1 + axis] + off[axis]
        return True

    def pressure(self, tick: int) -> None:
        if due(tick, self._tick_ns, self._depth_ns):
            self.depth = self._depth_sample(tick)

    def depth_sigma(self) -> float:
        """The standard deviation of the depth [m]."""
        return hypot(self._config.grade.depth_bias, self._config.grade.depth_noise)

    def displacement(self, moved: Vec3, current: Vec3, psi: float, dt: float) -> tuple[float, float]:
        """Measured displacement forward and to starboard in the horizontal plane [m].

        Args:
            moved: over ground [m, NED].
            current: m/s, NED.
            psi: heading, in the middle of the way [rad].
            dt: the time it took [s].
        """
        if self.mode == LOST:
            return self.held[0] * dt, self.held[1] * dt
        north, east, _ = moved
        if self.mode == WATER:
            north -= current[0] * dt
            east -= current[1] * dt
        c, s = cos(psi), sin(psi)
        forward, starboard = c * north + s * east, c * east - s * north
        return self.scale * forward + self.dvl[0] * dt, self.scale * starboard + self.dvl[1] * dt

    def _depth_sample(self, tick: int) -> float:
        return self._depth_bias + self._draw(self._config.grade.depth_noise, "depth", tick)

    def _draw(self, sigma: float, what: str, *key: int) -> float:
        # An instrument without an error is not drawn: hashing costs more than the rest of the sample.
        return sigma * normal(self._seed, f"{PURPOSE} {what}", self._i, *key) if sigma else 0.0


MOST_SOURCES = 8
NOISE, LOSS = f"{PURPOSE} fix", f"{PURPOSE} fix loss"


class Fixes:
    """The fixes of one vehicle: those under way."""

    def __init__(self, sources: tuple[FixSource, ...], seed: int, i: int, tick_ns: int) -> None:
        self._sources, self._seed, self._i, self._tick_ns = sources, seed, i, tick_ns
        # Due tick, tick at which it was measured, number of the source, north, east [m], sigma [m].
        self._under_way: list[list[float]] = []

    def measure(self, tick: int, true: Vec3, estimate: NavigationFilter, faults: Sequence[WorldFault]) -> None:
        """Measure what is due at a tick. `true`: position [m, NED]. `estimate`: of the position at this tick."""
        seed, i = self._seed, self._i
        for number, source in enumerate(self._sources):
            if not due(tick, self._tick_ns, source.period_ns):
                continue
            sigma = _sigma(source, true)
            if sigma < 0.0 or (source.loss > 0.0 and uniform(seed, LOSS, i, tick, number) < source.loss):
                continue
            gone = False
            off = [sigma * normal(seed, NOISE, i, tick, number, axis) for axis in range(2)]
            for fault in faults:
                if fault.kind == WorldFaultKind.FIX:
                    gone = gone or is_sample_lost(fault, seed, i, tick, number)
                    jump = jumps(fault, seed, i, tick, 2, number)
                    off = [off[axis] + fault.values[1 + axis] + jump[axis] for axis in range(2)]
            if gone:
                continue
            estimate.keep_position(self._key(tick, number))
            later = tick + -(-source.delay_ns // self._tick_ns)
            self._under_way.append([later, tick, number, true[0] + off[0], true[1] + off[1], sigma])

    def use(self, tick: int, estimate: NavigationFilter) -> list[Fix]:
        """Let the filter have what is due; returns these fixes."""
        found: list[Fix] = []
        ready = [one for one in self._under_way if one[0] <= tick]
        if not ready:
            return found
        self._under_way = [one for one in self._under_way if one[0] > tick]
        for _, then, source, north, east, sigma in ready:
            measured, number = int(then), int(source)
            nis, used = estimate.position(self._key(measured, number), north, east, sigma)
            found.append(Fix(self._sources[number].kind, measured, tick, (north, east), sigma, nis, used))
        return found

    @staticmethod
    def _key(tick: int, number: int) -> int:
        return tick * MOST_SOURCES + number


def _sigma(source: FixSource, true: Vec3) -> float:
    """The standard deviation of a fix on each axis [m]; negative: there is none."""
    if source.kind == "gps":
        return source.noise if true[2] <= source.depth else -1.0
    x, y, z = source.at
    distance = hypot(true[0] - x, true[1] - y, true[2] - z)
    if source.reach and distance > source.reach:
        return -1.0
    return hypot(source.noise, source.growth * distance)
