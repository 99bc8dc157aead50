"""The disturbances of all vehicles: a periodic one, a sum of one harmonic per equation of motion, and currents.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| d_n(t) = amplitude sin(omega t + phase) | force or moment on equation n = 1..5 | N, N m | body | (2) |

Currents change with time, by a Gauss-Markov drift and by gusts:

| symbol [m/s] | meaning | source |
|---|---|---|
| X_k+1 = phi X_k + sigma sqrt(1 - phi^2) n_k, phi = exp(-Ts / T) | first-order Gauss-Markov, exact | Fossen 2011, 8.3 |
| X_0 = sigma n | so that it is stationary from the start | |
| V (1 - cos(2 pi t / D)) / 2, 0 <= t < D | a discrete gust | MIL-F-8785C |

Within a tick a current is constant. The model leaves out the effect of its change on the added mass. At a time constant
of 10 s and 0.1 m/s the water accelerates by some 0.01 m/s^2, and the effect is 1 % of that of the paper's disturbance.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt

from netem.draws import normal
from world.config import Harmonic
from world.vectors import Vec3, Vec5

NO_FORCE: Vec5 = (0.0, 0.0, 0.0, 0.0, 0.0)

# The paper's simulation: (3.1 sin t, 3.1 cos t, 2.1 sin t, 1.1 sin t, 1.1 sin t), the same on every vehicle.
PAPER: tuple[Harmonic, ...] = (
    Harmonic(3.1),
    Harmonic(3.1, phase=pi / 2),
    Harmonic(2.1),
    Harmonic(1.1),
    Harmonic(1.1),
)


def disturbance(harmonics: tuple[Harmonic, ...], t: float) -> Vec5:
    """The disturbance at a time. `harmonics`: one for each equation of motion, or fewer; none: no disturbance. `t`:
    time [s]. Returns d1..d5 [N, N m, body]; 0 on an equation without a harmonic.
    """
    if not harmonics:
        return NO_FORCE
    d = [h.amplitude * sin(h.omega * t + h.phase) if h.amplitude else 0.0 for h in harmonics]
    d1, d2, d3, d4, d5 = d + [0.0] * (5 - len(d))
    return d1, d2, d3, d4, d5


def purpose(name: str) -> str:
    """The text that distinguishes a drift from all other draws."""
    return f"current {name}"


class GaussMarkov:
    """A drift round zero; its value at a tick is a function of (seed, purpose, tick) alone."""

    def __init__(self, sigma: Vec3, time_constant_s: float, tick_s: float, seed: int, purpose: str) -> None:
        """`sigma` is the standard deviation on each axis [m/s, NED]; `purpose` distinguishes this drift from all other
        draws of the run.
        """
        self._sigma, self._seed, self._purpose = sigma, seed, purpose
        self._phi = exp(-tick_s / time_constant_s)
        self._kick = sqrt(1.0 - self._phi**2)
        self._known: list[Vec3] = []

    def at(self, tick: int) -> Vec3:
        """The current [m/s, NED] at `tick`, counted from the beginning of the drift."""
        while len(self._known) <= tick:
            self._known.append(self._next(len(self._known)))
        return self._known[tick]

    def _next(self, k: int) -> Vec3:
        drawn = [s * normal(self._seed, self._purpose, k, axis) if s else 0.0 for axis, s in enumerate(self._sigma)]
        if not self._known:
            return drawn[0], drawn[1], drawn[2]
        (x, y, z), phi, kick = self._known[-1], self._phi, self._kick
        return phi * x + kick * drawn[0], phi * y + kick * drawn[1], phi * z + kick * drawn[2]


def gust(velocity: Vec3, over_s: float, t: float) -> Vec3:
    """The current [m/s, NED] `t` [s] after the begin of a gust that rises to `velocity` and falls once, within
    `over_s`.
    """
    share = 0.5 * (1.0 - cos(2.0 * pi * t / over_s)) if t < over_s else 0.0
    return share * velocity[0], share * velocity[1], share * velocity[2]
