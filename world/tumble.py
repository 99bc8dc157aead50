"""When a vehicle tumbles: its pitch goes beyond a limit, and comes back well within it.

| symbol | meaning | unit |
|---|---|---|
| theta | pitch of the hull, any number of turns | rad |
| q = theta' | pitch rate | rad/s |
| limit | |pitch| beyond which the vehicle tumbles; upside down is beyond | rad |

The criterion does not depend on where ticks fall: between two ticks theta is the cubic through both pitches with
both rates, and its peak counts. The tumble ends when |pitch| is HYSTERESIS_RAD below the limit (half the limit, where
that is less), so that a vehicle that sways about the limit tumbles once.
"""

from __future__ import annotations

from math import inf, pi, radians, remainder, sqrt

LIMIT_RAD = radians(80.0)
HYSTERESIS_RAD = radians(10.0)


def tumbles(tumbled: bool, limit: float, before: tuple[float, float], after: tuple[float, float], h: float) -> bool:
    """Whether a vehicle is tumbled, beyond the |pitch| `limit` [rad], after a tick of `h` [s] between two (theta, q)
    [rad, rad/s]; `tumbled`: it was before.
    """
    theta = after[0]
    if tumbled:
        return abs(remainder(theta, 2.0 * pi)) > limit - min(HYSTERESIS_RAD, 0.5 * limit)
    if abs(theta) < limit and abs(before[0]) < limit and before[1] * after[1] >= 0.0:
        return False
    if abs(remainder(theta, 2.0 * pi)) > limit or round(before[0] / (2.0 * pi)) != round(theta / (2.0 * pi)):
        return True
    low, high = _range(before, after, h)
    turns = 2.0 * pi * round(theta / (2.0 * pi))
    return high - turns > limit or low - turns < -limit


def _range(before: tuple[float, float], after: tuple[float, float], h: float) -> tuple[float, float]:
    """Least and greatest pitch on the cubic from one end of a tick to the other [rad]."""
    (a, qa), (b, qb) = before, after
    # theta(s) = a + c1 s + c2 s^2 + c3 s^3, s from 0 to 1.
    c1 = h * qa
    c2 = 3.0 * (b - a) - h * (2.0 * qa + qb)
    c3 = 2.0 * (a - b) + h * (qa + qb)
    values = [a, b, *(a + s * (c1 + s * (c2 + s * c3)) for s in _roots(3.0 * c3, 2.0 * c2, c1) if 0.0 < s < 1.0)]
    return min(values), max(values)


def _roots(a: float, b: float, c: float) -> tuple[float, ...]:
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        return ()
    half = -0.5 * (b + (sqrt(discriminant) if b >= 0.0 else -sqrt(discriminant)))
    return (half / a if a else inf, c / half if half else inf)
