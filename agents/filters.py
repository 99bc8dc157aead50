"""Angles and their measured rates.

| symbol | meaning | unit | source |
|---|---|---|---|
| s_k | a sampled angle | rad | - |
| d_k = alpha d_{k-1} + (1 - alpha) wrap(s_k - s_{k-1}) / dt, d_0 = 0 | its filtered rate | rad/s | chosen |
| alpha = exp(-dt / tau_f) | forgetting per sample | 1 | chosen |

The paper needs derivatives of commanded and of measured flow angles and does not say how to get them. The
derivative of a noiseless model would miss the disturbance, so differences are used; they are filtered because
every new optimal gain steps the commanded angles.
"""

from __future__ import annotations

from math import exp, pi, remainder

TWO_PI = 2.0 * pi


def wrap(angle: float) -> float:
    """The angle [rad] in (-pi, pi] that differs from `angle` by whole turns.

    Raises:
        ValueError: the angle is infinite.
    """
    if -pi < angle <= pi:
        return angle
    wrapped = remainder(angle, TWO_PI)
    return pi if wrapped <= -pi else wrapped


class AngleRateFilter:
    """Filtered backward difference of one angle; its first sample gives 0."""

    __slots__ = ("_alpha", "_dt", "_tau_f", "angle", "rate")

    def __init__(self, tau_f: float) -> None:
        self._tau_f = tau_f
        self._dt = self._alpha = 0.0
        self.angle: float | None = None
        self.rate = 0.0

    def step(self, angle: float, dt: float) -> float:
        """The rate [rad/s] after a sample `angle` [rad], dt [s] after the previous one."""
        previous = self.angle
        self.angle = angle
        if previous is None:
            return 0.0
        if dt != self._dt:
            self._dt = dt
            self._alpha = exp(-dt / self._tau_f) if self._tau_f > 0.0 else 0.0
        difference = angle - previous
        if not -pi < difference <= pi:
            difference = wrap(difference)
        alpha = self._alpha
        self.rate = rate = alpha * self.rate + (1.0 - alpha) * difference / dt
        return rate

    def state(self) -> list[float | None]:
        return [self.angle, self.rate]

    def restore(self, values: list[float | None]) -> None:
        angle, rate = values
        self.angle = angle
        self.rate = rate or 0.0
