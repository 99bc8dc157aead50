"""The measurements of a vehicle's instruments: heading sensor, gyros, DVL and pressure sensor, each with its rate.

| symbol | meaning | unit |
|---|---|---|
| psi + b + w + n | heading sensor: bias, random walk of the bias, noise of the sample | rad |
| q + g + n | gyro on each axis: bias; noise that makes an angle random walk | rad/s |
| (1 + s) v + n | DVL: scale error, noise of the sample; v over ground, or through the water | m/s |
| z + b + n | pressure sensor: bias, noise of the sample | m |

Between two samples of the DVL and of the pressure sensor the accelerometers carry what was measured on: the error stays
that of the sample. A bias is drawn once per run and vehicle. Each draw is a pure function of (seed, vehicle, tick,
purpose), so the vehicles may move in any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin, sqrt

from netem.draws import normal
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import WorldFault
from world.navigation.config import DeadReckoning, jumps, lost
from world.navigation.filter import BOTTOM, LOST, WATER
from world.vectors import Vec3

PURPOSE = "navigation"
NO_FAULTS: Sequence[WorldFault] = ()


def due(tick: int, tick_ns: int, period_ns: int) -> bool:
    """Whether a sample is due at a tick: the first at or after each multiple of its period."""
    return tick * tick_ns // period_ns > (tick - 1) * tick_ns // period_ns


class Instruments:
    def __init__(self, config: DeadReckoning, seed: int, i: int, tick_ns: int) -> None:
        grade = config.grade
        self._config, self._seed, self._i, self._tick_ns = config, seed, i, tick_ns
        rates = (grade.heading_rate, grade.gyro_rate, grade.dvl_rate, grade.depth_rate)
        self._heading_ns, self._gyro_ns, self._dvl_ns, self._depth_ns = (max(1, round(1e9 / rate)) for rate in rates)
        self._heading_s: float = max(self._heading_ns, tick_ns) / 1e9  # from sample to sample
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
                if lost(fault, self._seed, self._i, tick):
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
                if lost(fault, self._seed, self._i, tick):
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
