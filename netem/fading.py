"""Fading of acoustic links: a slow gain (log-normal shadowing) and a fast one (Rician or Rayleigh), in decibels.

Both belong to a directed link and are pure functions of (seed, link, time). Nothing is remembered, so packets can be
judged in any order.

| symbol | meaning | unit |
|---|---|---|
| sigma, tau | standard deviation of the shadowing; time after which its correlation is 1/e | dB, s |
| Z_n | independent standard normal numbers of a link, one per tau/2 | 1 |
| K | power of the steady path over that of all scattered ones; 0: Rayleigh | 1 |

Shadowing is sigma S(t) with S(t) = sum_n g(t/h - n) Z_n / sqrt(sum_n g(t/h - n)^2), h = tau/2 and g(u) = exp(-u^2/2):
a stationary Gaussian process with variance 1 and correlation exp(-(lag/tau)^2). The fast gain of a packet is
|sqrt(K/(K+1)) + (X + iY)/sqrt(2(K+1))|^2 with normal X and Y, whose mean is 1.
"""

from __future__ import annotations

from math import exp, sqrt

from netem.draws import normal
from netem.propagation import decibels

SHADOWING, SCATTER = "shadowing", "scatter"  # purposes of draws
_REACH = 5  # g is 4e-6 beyond it
_LEAST = 1e-30  # a power that is lost for sure


def gain_db(seed: int, src: int, dst: int, at_ns: int, sigma: float, tau_ns: int, k: float | None) -> float:
    """The gain [dB] that fading adds to the level of a transmission that begins at `at_ns`.

    If `k` is None, there is no fast fading.
    """
    gain = sigma * _shadowing(seed, src, dst, at_ns, tau_ns) if sigma else 0.0
    return gain if k is None else gain + decibels(max(_LEAST, _scatter(seed, src, dst, at_ns, k)))


def _shadowing(seed: int, src: int, dst: int, at_ns: int, tau_ns: int) -> float:
    if not tau_ns:  # it never changes
        return normal(seed, SHADOWING, src, dst, 0)
    place = at_ns / (tau_ns / 2.0)
    total = power = 0.0
    for n in range(int(place) - _REACH, int(place) + _REACH + 2):
        weight = exp(-0.5 * (place - n) * (place - n))
        total += weight * normal(seed, SHADOWING, src, dst, n)
        power += weight * weight
    return total / sqrt(power)


def _scatter(seed: int, src: int, dst: int, at_ns: int, k: float) -> float:
    spread = sqrt(0.5 / (k + 1.0))
    x = sqrt(k / (k + 1.0)) + spread * normal(seed, SCATTER, src, dst, at_ns, 0)
    y = spread * normal(seed, SCATTER, src, dst, at_ns, 1)
    return x * x + y * y
