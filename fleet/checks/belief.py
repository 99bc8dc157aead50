"""A vehicle's belief about its position against the truth: the values of its topic `belief` at a tick.

| symbol | meaning | unit |
|---|---|---|
| P | covariance of the estimate of x, y, z (NED) and psi | m^2, m rad, rad^2 |
| d | the estimate minus the truth, NED | m |
| NEES = d^T P^-1 d | of x, y, z: of a consistent filter it is chi-square with 3 degrees of freedom | 1 |
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan, sqrt
from typing import Protocol

from fleet.scenario.sections.signals import BELIEF
from netem.wire.messages import VehicleFrame
from world.vectors import Vec3

SIZE = sum(signal.width for signal in BELIEF)
_UNKNOWN: tuple[float, ...] = (nan,) * 10  # a replayed error has no covariance


class OffPlace(Protocol):
    """The true formation error of a vehicle: its position minus its desired position [m, NED]."""

    @property
    def formation(self) -> Vec3: ...


def belief_values(row: VehicleFrame, error: OffPlace) -> tuple[float, ...]:
    """The values of the topic `belief`, one after the other in the order of `BELIEF`.

    Args:
        row: the frame's row of the vehicle.
        error: the vehicle's true formation error.

    Returns:
        The values; empty if no agent got a measurement of this vehicle at this tick.
    """
    if not row.nav:
        return ()
    p = row.belief or _UNKNOWN
    dx, dy, dz = (believed - true for believed, true in zip(row.nav[:3], row.eta[:3], strict=True))
    fx, fy, fz = error.formation
    bx, by, bz = fx + dx, fy + dy, fz + dz
    deviations = [sqrt(max(0.0, value)) if value == value else nan for value in (p[0], p[4], p[7], p[9])]
    return (
        *deviations, *p, dx, dy, dz, hypot(dx, dy, dz), _nees(p, (dx, dy, dz)), bx, by, bz, hypot(bx, by, bz)
    )  # fmt: skip


def _nees(p: Sequence[float], d: Vec3) -> float:
    """d^T P^-1 d; NaN of a covariance that has no inverse."""
    xx, xy, xz, _, yy, yz, _, zz, _, _ = p
    x, y, z = d
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * c
    if not determinant > 0.0:
        return nan
    e, f, g = xx * zz - xz * xz, xz * xy - xx * yz, xx * yy - xy * xy
    return (a * x * x + e * y * y + g * z * z + 2.0 * (b * x * y + c * x * z + f * y * z)) / determinant
