"""A vehicle's belief about itself: the estimate that its agent gets in place of the truth."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, isfinite, sin

from netem.draws import normal
from netem.wire.messages import Fix, WorldFault
from world.navigation.config import DeadReckoning
from world.navigation.filter import BOTTOM, CE, CN, LOST, PSI, WATER, E, N, NavigationFilter, S
from world.navigation.instruments import PURPOSE, Fixes, Instruments
from world.vectors import Vec3, Vec5

# x, y, z [m, NED], theta, psi [rad], u, v, w [m/s, body, over ground], q, r [rad/s]
State = tuple[float, float, float, float, float, float, float, float, float, float]
START = f"{PURPOSE} start"
MOST_MPS = 1e9  # an error of the velocity; beyond it what follows could leave the finite numbers
MOST_TOLD = 200  # fixes in a frame, which has to fit into a message; a log that is thinned has the newest
Believed = tuple[Vec5, Vec5, tuple[float, ...]]  # eta, nu, roll


class Navigator:
    """Dead reckoning of one vehicle: its instruments, its fixes and its filter."""

    def __init__(self, config: DeadReckoning, seed: int, i: int, tick_ns: int, state: State) -> None:
        """Begin with the true state at the start."""
        self._config = config
        self._dt = tick_ns / 1e9
        self._seed, self._i = seed, i
        self._instruments = Instruments(config, seed, i, tick_ns)
        self._fixes = Fixes(config.fixes, seed, i, tick_ns)
        self.filter: NavigationFilter
        self._tick: int = 0
        self._current: Vec3 = (0.0, 0.0, 0.0)
        self._tell: list[Fix] = []  # fixes that `take_fixes` has not given out yet
        self.begin(0, state)

    def begin(self, tick: int, state: State) -> None:
        """Begin with the true state at a tick."""
        start, purpose = self._config.start, START
        off = [start * normal(self._seed, purpose, self._i, axis) if start else 0.0 for axis in range(2)]
        self._instruments.turn_rates(0)
        self._instruments.velocity(0, state[2])
        heading = self._instruments.heading(0, state[4])
        assert heading is not None  # there is one at the start
        self.filter = NavigationFilter(self._config, state[0] + off[0], state[1] + off[1], heading)
        self._tick = tick

    def step(self, before: State, after: State, current: Vec3, faults: Sequence[WorldFault], phi: float) -> None:
        """Take what is measured on the way to the next tick.

        Args:
            before: the true state at the present tick.
            after: the true state at the next tick.
            current: the current between both ticks [m/s, NED].
            faults: the faults that act on this vehicle at the next tick.
            phi: the true roll at the next tick [rad].

        Raises:
            OverflowError, ValueError, ZeroDivisionError: the estimate left the finite numbers.
        """
        tick, dt = self._tick + 1, self._dt
        self._tick = tick
        measure, known = self._instruments, self.filter
        x0, y0, z0, x1, y1, z1 = before[0], before[1], before[2], after[0], after[1], after[2]
        turn = after[4] - before[4] + measure.gyro[0] * dt
        moved = x1 - x0, y1 - y0, z1 - z0
        forward, starboard = measure.displacement(moved, current, 0.5 * (before[4] + after[4]), dt)
        known.advance(turn, forward, starboard, dt, measure.mode)
        self._current = current
        measure.turn_rates(tick)
        velocity = measure.held if measure.mode == LOST else self._velocity(after, phi)
        if measure.velocity(tick, z1, faults):
            known.settle()
            if measure.mode == LOST:
                measure.held = velocity
        measure.pressure(tick)
        heading = measure.heading(tick, after[4], faults)
        if heading is not None:
            known.heading(heading, self._config.grade.heading_noise)
        if self._config.fixes:
            true: Vec3 = (x1, y1, z1)
            self._fixes.measure(tick, true, known, faults)
            self._tell = (self._tell + self._fixes.use(tick, known))[-MOST_TOLD:]
        u, v, w = measure.dvl
        if not isfinite(sum(known.x)) or not abs(u) + abs(v) + abs(w) < MOST_MPS:
            raise OverflowError("the estimate is not finite")

    def _velocity(self, state: State, phi: float) -> list[float]:
        measure = self._instruments
        own = [state[5], state[6], state[7]]
        if measure.mode == WATER:
            drift = body(self._current, phi, state[3], state[4])
            own = [own[0] - drift[0], own[1] - drift[1], own[2] - drift[2]]
        scale, off = measure.scale, measure.dvl
        return [scale * own[0] + off[0], scale * own[1] + off[1], scale * own[2] + off[2]]

    def belief(self, state: State, roll: tuple[float, ...]) -> Believed:
        """Eta, nu and roll as the vehicle believes them. `state`: the truth. `roll`: true phi [rad] and p [rad/s], or
        nothing."""
        measure, x = self._instruments, self.filter.x
        pitch, lean = measure.tilt
        theta = state[3] + pitch
        phi = roll[0] if roll else 0.0
        if measure.mode == LOST:
            u, v, w = measure.held
        else:
            u, v, w = self._velocity(state, phi)
        scale = 1.0 + x[S]
        u, v, w = u / scale, v / scale, w / scale
        if measure.mode != BOTTOM:
            drift = body((x[CN], x[CE], 0.0), phi, theta, x[PSI])
            u, v, w = u + drift[0], v + drift[1], w + drift[2]
        yaw, q, p = measure.gyro
        eta = x[N], x[E], state[2] + measure.depth, theta, x[PSI]
        nu = u, v, w, state[8] + q, state[9] + yaw
        return eta, nu, (roll[0] + lean, roll[1] + p) if roll else ()

    def covariance(self) -> tuple[float, ...]:
        """The covariance of x, y, z and psi, since the last sample: upper triangle, row by row [m^2, m rad, rad^2]."""
        p = self.filter.p
        depth = self._instruments.depth_sigma() ** 2
        return (p[N][N], p[N][E], 0.0, p[N][PSI], p[E][E], 0.0, p[E][PSI], depth, 0.0, p[PSI][PSI])

    def take_fixes(self) -> tuple[Fix, ...]:
        if not self._tell:
            return ()
        taken = tuple(self._tell)
        self._tell = []
        return taken


def body(vector: Vec3, phi: float, theta: float, psi: float) -> Vec3:
    """A vector in NED in the axes of a body: R_bn v, with R_nb = Rz(psi) Ry(theta) Rx(phi)."""
    x, y, z = vector
    c, s = cos(psi), sin(psi)
    x, y = c * x + s * y, c * y - s * x
    c, s = cos(theta), sin(theta)
    x, z = c * x - s * z, s * x + c * z
    if phi:
        c, s = cos(phi), sin(phi)
        y, z = c * y + s * z, c * z - s * y
    return x, y, z
