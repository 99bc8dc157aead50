r"""The own position, corrected by a measured range to another vehicle.

| symbol | meaning | unit |
|---|---|---|
| p, P | own horizontal position and its covariance | m, m^2 |
| q, Q | the same of the other vehicle, as its message says | m, m^2 |
| h = sqrt(\|p - q\|^2 + dz^2) | expected range; depths are known | m |
| H = (p - q)^T / h | its gradient with respect to p; with respect to q it is -H | 1 |
| C = (tr(P + Q) - H (P + Q) H^T) / h | the curvature of the range, over the spread of both positions | m |
| R = r + C^2 / 2 | variance of the range beside P and Q: that of the measurement, and of the curvature | m^2 |
| z - h - C / 2 | innovation of a measured range z | m |

The terms with C are those of the second-order extended Kalman filter (Bar-Shalom, Li and Kirubarajan 2001, ch. 10.3).

*As independent* (naive): a Kalman update with S = H P H^T + H Q H^T + R.

*By covariance intersection*, with any correlation between p and q (Julier and Uhlmann 1997). The noise of the range
is independent of both, so this is split covariance intersection (Li and Nashashibi 2013):

    P1 = P / w,  S = H P1 H^T + H Q H^T / (1 - w) + R,  K = P1 H^T / S,  P+ = P1 - K S K^T

with the w that makes the trace of P+ least. A result that is not better than P is not used.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

Covariance = tuple[float, float, float]  # nn, ne, ee of north and east [m^2]
_LEAST_RANGE = 0.1  # m; nearer, a range has no direction
_WEIGHTS = tuple(1.0 - 2.0 ** (-0.5 * k) for k in range(1, 25))  # tried for the own position: 0.29 to 0.9998


class Fused(NamedTuple):
    """A position after a range."""

    north: float
    east: float
    covariance: Covariance
    nis: float  # normalised square of the innovation; chi-square with 1 degree of freedom


def fuse_range(
    place: tuple[float, float],
    covariance: Covariance,
    other: tuple[float, float],
    other_covariance: Covariance,
    depth_m: float,
    range_m: float,
    variance: float,
    independent: bool,
) -> Fused | None:
    """Correct the own position by a measured range to another vehicle.

    Args:
        place: the own position, north and east [m].
        covariance: of the own position [m^2].
        other: the position of the other vehicle, north and east [m].
        other_covariance: of that position [m^2].
        depth_m: the difference of the depths [m].
        range_m: the measured range [m].
        variance: variance r of the measurement [m^2].
        independent: the errors of both positions are independent.

    Returns:
        The corrected position. None: the range does not help, since the vehicles are too close or no weight of the own
        position gives a smaller covariance.
    """
    dn, de = place[0] - other[0], place[1] - other[1]
    h = sqrt(dn * dn + de * de + depth_m * depth_m)
    if h < _LEAST_RANGE:
        return None
    n, e = dn / h, de / h
    across = _along(other_covariance, n, e)
    spread = covariance[0] + covariance[2] + other_covariance[0] + other_covariance[2]
    curved = (spread - _along(covariance, n, e) - across) / h
    noise = variance + 0.5 * curved * curved
    innovation = range_m - h - 0.5 * curved
    if independent or across == 0.0:
        s, gain, better = _update(covariance, n, e, across + noise)
    else:
        s, gain, better = 0.0, (0.0, 0.0), covariance
        for w in _WEIGHTS:
            nn, ne, ee = covariance
            found = _update((nn / w, ne / w, ee / w), n, e, across / (1.0 - w) + noise)
            if found[2][0] + found[2][2] < better[0] + better[2]:
                s, gain, better = found
        if s == 0.0:
            return None
    kn, ke = gain
    return Fused(place[0] + kn * innovation, place[1] + ke * innovation, better, innovation * innovation / s)


def grown(covariance: Covariance, before: Covariance, after: Covariance) -> Covariance:
    """A covariance that grows by as much as another one did, in the same directions."""
    a, b, c = after[0] - before[0], after[1] - before[1], after[2] - before[2]
    middle, radius = 0.5 * (a + c), sqrt(0.25 * (a - c) * (a - c) + b * b)
    if middle + radius <= 0.0:
        return covariance
    if middle < radius:  # the covariance shrank in one direction: only the other counts
        share = 0.5 * (middle + radius) / radius
        a, b, c = share * (a - middle + radius), share * b, share * (c - middle + radius)
    return covariance[0] + a, covariance[1] + b, covariance[2] + c


def _along(covariance: Covariance, n: float, e: float) -> float:
    """Variance along a direction: H P H^T."""
    nn, ne, ee = covariance
    return n * n * nn + 2.0 * n * e * ne + e * e * ee


def _update(covariance: Covariance, n: float, e: float, noise: float) -> tuple[float, tuple[float, float], Covariance]:
    """S, K, and the covariance after a scalar measurement along (n, e)."""
    nn, ne, ee = covariance
    hn, he = n * nn + e * ne, n * ne + e * ee
    s = n * hn + e * he + noise
    return s, (hn / s, he / s), (nn - hn * hn / s, ne - hn * he / s, ee - he * he / s)
