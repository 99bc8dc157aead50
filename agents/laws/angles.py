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
    """Bring an angle into one turn.

    Args:
        angle: any angle [rad].

    Returns:
        The angle [rad] in (-pi, pi] that differs from it by whole turns.

    Raises:
        ValueError: the angle is infinite.
    """
    if -pi < angle <= pi:
        return angle
    wrapped = remainder(angle, TWO_PI)
    return pi if wrapped <= -pi else wrapped


class RateFilter:
    """Filtered backward difference of one signal; its first sample gives 0."""

    __slots__ = ("_alpha", "_angle", "_dt", "_tau_f", "rate", "value")

    def __init__(self, tau_f: float, *, angle: bool = False) -> None:
        """Begin without a sample.

        Args:
            tau_f: time constant [s]; 0 does not filter.
            angle: the signal is an angle [rad], and its differences are wrapped to (-pi, pi].
        """
        self._tau_f = tau_f
        self._angle = angle
        self._dt = self._alpha = 0.0
        self.value: float | None = None
        self.rate = 0.0

    def step(self, value: float, dt: float) -> float:
        """Take one sample.

        Args:
            value: of the signal, in its unit.
            dt: time since the sample before [s].

        Returns:
            The rate [unit of the value per s].
        """
        previous = self.value
        self.value = value
        if previous is None:
            return 0.0
        if dt != self._dt:
            self._dt = dt
            self._alpha = exp(-dt / self._tau_f) if self._tau_f > 0.0 else 0.0
        alpha = self._alpha
        difference = value - previous
        if self._angle and not -pi < difference <= pi:
            difference = wrap(difference)
        self.rate = rate = alpha * self.rate + (1.0 - alpha) * difference / dt
        return rate
