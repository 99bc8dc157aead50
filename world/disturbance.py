"""The periodic disturbance: a sum of one harmonic per equation of motion.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| d_n(t) = amplitude sin(omega t + phase) | force or moment on equation n = 1..5 | N, N m | body | (2) |
"""

from __future__ import annotations

from math import pi, sin

from world.config import Harmonic
from world.vectors import Vec5

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
