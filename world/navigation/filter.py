"""The error-state Kalman filter of a vehicle that navigates by dead reckoning.

The estimate follows the measured turns and displacements. The filter holds the covariance of its error, and what it
learns from a measurement goes into the estimate at once, so that the expected error is always zero. A fix that is used
later than it was measured is one of a past position, which the filter keeps with its covariances (stochastic cloning,
Roumeliotis and Burdick 2002).

| symbol | meaning | unit | propagation of its error over a time T |
|---|---|---|---|
| n, e | position, north and east | m | dn' = dn - E dpsi - N ds / (1 + s) + T dc_n, likewise de with N dpsi |
| psi | heading | rad | dpsi' = dpsi - T dg |
| h | bias of the heading sensor | rad | random walk |
| g | bias of the yaw gyro | rad/s | constant |
| s | scale error of the DVL | 1 | constant |
| c_n, c_e | current; while the DVL gives nothing, what the last velocity is off by | m/s | first-order Gauss-Markov |

(N, E) is the displacement by the DVL over T, in NED. d means estimate minus truth. A measurement z = psi + h + noise of
the heading, or of n and e, is one scalar update after the other (Groves 2013, ch. 3 and 14).

Without the past position, the innovation of a late fix with the present covariance gave a NIS of 1.4 in a current,
which is too cautious. With it the NIS is 2, within its interval.

The depth is not filtered: its error is the bias and the noise of the last sample, exactly as the covariance says. A
filter of the depth would need the vertical scale error of the DVL, which is correlated over a dive.

The covariance is updated at samples of instruments, not at ticks. An update whenever a vehicle is sensed would make the
bits of a result depend on who looks, and would cost three times as much.

Matrices are lists of rows, and sums have a fixed order: the bits of a result are the same on every machine.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt

from world.navigation.config import DeadReckoning

N, E, PSI, H, G, S, CN, CE = range(8)
SIZE = 8
GATE = 13.816  # chi-square with 2 degrees of freedom, 99.9 %
MOST_REFUSED = 5  # fixes in a row: after that the estimate is wrong and not the fix
# While the DVL gives nothing, the last velocity holds, and is off by this much. An assumption: a vehicle that goes on
# at its usual speed, in slow waves and turns.
COAST_MPS, COAST_S = 0.3, 60.0
BOTTOM, WATER, LOST = 0, 1, 2  # what the DVL sees


class NavigationFilter:
    """Estimate and covariance of one vehicle; all of it is floats, so it can be copied as it is."""

    def __init__(self, config: DeadReckoning, north: float, east: float, heading: float) -> None:
        """Begin.

        Args:
            config: the errors that the filter expects.
            north, east: what is known of the position [m], with the standard deviation `config.start`.
            heading: the first sample of the heading sensor [rad].
        """
        grade = config.grade
        self._config = config
        self.x: list[float] = [north, east, heading, 0.0, 0.0, 0.0, 0.0, 0.0]
        self.p: list[list[float]] = [[0.0] * SIZE for _ in range(SIZE)]
        p = self.p
        p[N][N] = p[E][E] = config.start**2
        bias = grade.heading_bias**2
        p[H][H] = bias
        p[PSI][PSI] = bias + grade.heading_noise**2
        # The heading is the first sample, so it is off by the bias: the error of the bias, 0 - h, is the opposite.
        p[PSI][H] = p[H][PSI] = -bias
        p[G][G] = grade.gyro_bias**2
        p[S][S] = grade.dvl_scale**2
        p[CN][CN] = p[CE][CE] = config.current_sigma**2
        # Noise of a velocity that lasts from sample to sample makes a random walk of the position [m^2/s].
        self._noise: float = grade.dvl_noise**2 / grade.dvl_rate
        self.kept: list[int] = []  # the numbers of past positions, whose n and e follow on the state
        self.mode: int = BOTTOM
        self.refused: int = 0  # fixes, in a row
        # What has come since the covariance was brought up to date.
        self.north: float = 0.0  # displacement by the DVL [m]
        self.east: float = 0.0
        self.time: float = 0.0  # s
        self.drifting: float = 0.0  # how long the vehicle has been without sight of the floor [s]

    def advance(self, turn: float, forward: float, starboard: float, dt: float, mode: int) -> None:
        """Move the estimate on.

        Args:
            turn: measured change of the heading [rad].
            forward, starboard: measured displacement in the horizontal plane [m].
            dt: over this time [s].
            mode: BOTTOM: displacement over ground; WATER: through water; LOST: by the last velocity that was known.
        """
        if mode != self.mode:
            self.settle()
            if mode == LOST or self.mode == LOST:
                self._forget_current(COAST_MPS if mode == LOST else self._config.current_sigma)
            self.mode = mode
        x = self.x
        turn -= x[G] * dt
        middle = x[PSI] + 0.5 * turn
        c, s = cos(middle), sin(middle)
        scale = 1.0 + x[S]
        forward, starboard = forward / scale, starboard / scale
        north, east = c * forward - s * starboard, s * forward + c * starboard
        self.north += north
        self.east += east
        self.time += dt
        if mode != BOTTOM:
            self.drifting += dt
            north += x[CN] * dt
            east += x[CE] * dt
        x[N] += north
        x[E] += east
        x[PSI] += turn

    def settle(self) -> None:
        """Bring the covariance up to date."""
        t = self.time
        if t == 0.0:
            return
        x, p = self.x, self.p
        factor = 1.0 / (1.0 + x[S])
        by_psi_n, by_psi_e = -self.east, self.north
        by_s_n, by_s_e = -self.north * factor, -self.east * factor
        drifting = self.drifting
        sigma, tau = self._config.current_sigma, self._config.current_time_s
        if self.mode == LOST:
            sigma, tau = COAST_MPS, COAST_S
        keep = exp(-t / tau)
        row_n, row_e, row_psi, row_g, row_s = p[N], p[E], p[PSI], p[G], p[S]
        row_cn, row_ce = p[CN], p[CE]
        for k in range(len(p)):
            row_n[k] += by_psi_n * row_psi[k] + by_s_n * row_s[k] + drifting * row_cn[k]
            row_e[k] += by_psi_e * row_psi[k] + by_s_e * row_s[k] + drifting * row_ce[k]
            row_psi[k] -= t * row_g[k]
            row_cn[k] *= keep
            row_ce[k] *= keep
        for row in p:
            row[N] += by_psi_n * row[PSI] + by_s_n * row[S] + drifting * row[CN]
            row[E] += by_psi_e * row[PSI] + by_s_e * row[S] + drifting * row[CE]
            row[PSI] -= t * row[G]
            row[CN] *= keep
            row[CE] *= keep
        x[CN] *= keep
        x[CE] *= keep
        new = sigma * sigma * (1.0 - keep * keep)
        row_n[N] += self._noise * t
        row_e[E] += self._noise * t
        row_psi[PSI] += self._config.grade.gyro_walk**2 * t
        p[H][H] += self._config.grade.heading_walk**2 * t
        row_cn[CN] += new
        row_ce[CE] += new
        self.north = self.east = self.time = self.drifting = 0.0

    def heading(self, measured: float, noise: float) -> float:
        """Take a sample of the heading sensor. `measured`: rad. `noise`: its standard deviation [rad]. Returns the
        innovation squared over its variance: NIS [1]."""
        self.settle()
        return self._update(PSI, H, measured - self.x[PSI] - self.x[H], noise * noise)

    def keep_position(self, key: int) -> None:
        self.settle()
        for i in (N, E):
            for row in self.p:
                row.append(row[i])
            self.p.append(list(self.p[i]))
            self.x.append(self.x[i])
        self.kept.append(key)

    def position(self, key: int, north: float, east: float, sigma: float) -> tuple[float, bool]:
        """Take a fix of a position that was kept, which is forgotten then.

        Args:
            key: its number.
            north, east: the fix [m].
            sigma: its standard deviation on each axis [m].

        Returns:
            NIS [1], with 2 degrees of freedom, and whether the fix was used.
        """
        self.settle()
        i = SIZE + 2 * self.kept.index(key)
        j, x, p, r = i + 1, self.x, self.p, sigma * sigma
        s_nn, s_ee, s_ne = p[i][i] + r, p[j][j] + r, p[i][j]
        determinant = s_nn * s_ee - s_ne * s_ne
        off_n, off_e = north - x[i], east - x[j]
        nis, used = 0.0, False
        if determinant > 0.0:  # at 0, position and fix are both exact
            nis = (s_ee * off_n * off_n - 2.0 * s_ne * off_n * off_e + s_nn * off_e * off_e) / determinant
            used = nis <= GATE or self.refused >= MOST_REFUSED
            if nis > GATE and used:
                self._widen(off_n * off_n, off_e * off_e)
            self.refused = 0 if used else self.refused + 1
        if used:
            self._update(i, -1, off_n, r)
            self._update(j, -1, east - x[j], r)
        self._forget(i)
        return nis, used

    def _widen(self, north: float, east: float) -> None:
        """The position, now and in the past, is more uncertain by these variances [m^2]."""
        for axis, by in ((N, north), (E, east)):
            own = [axis, *range(SIZE + axis, len(self.p), 2)]
            for a in own:
                for b in own:
                    self.p[a][b] += by

    def _forget(self, i: int) -> None:
        del self.kept[(i - SIZE) // 2]
        del self.x[i : i + 2]
        del self.p[i : i + 2]
        for row in self.p:
            del row[i : i + 2]

    def _update(self, i: int, j: int, innovation: float, r: float) -> float:
        """A scalar update with what is measured of x_i, or of x_i + x_j (j < 0: of x_i alone), with variance r."""
        x, p = self.x, self.p
        gains = [row[i] + row[j] for row in p] if j >= 0 else [row[i] for row in p]
        s = gains[i] + (gains[j] if j >= 0 else 0.0) + r
        if s <= 0.0:
            return 0.0
        share = innovation / s
        for a, row in enumerate(p):
            gain = gains[a]
            if gain == 0.0:
                continue
            x[a] += gain * share
            for b, other in enumerate(gains):
                row[b] -= gain * other / s  # the product first: it stays symmetric to the last bit
        return innovation * share

    def _forget_current(self, sigma: float) -> None:
        for k in (CN, CE):
            self.x[k] = 0.0
            for a in range(len(self.p)):
                self.p[k][a] = self.p[a][k] = 0.0
            self.p[k][k] = sigma * sigma

    def sigma(self, i: int) -> float:
        """The standard deviation of x_i."""
        return sqrt(max(0.0, self.p[i][i]))
