"""The consensus error of one vehicle (eq. 8).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| e_i | consensus error | m | NED | (8) |
| a_ij, b_i | weight of neighbour j, weight of the own reference | 1 | - | (8) |
| Delta_ij | desired offset, p_i - p_j | m | NED | (8) |
| pd_i | desired position, eta_1^d(t) + p_i | m | NED | (11) |
| c_i = sum_j a_ij + b_i | total weight | 1 | - | (18) |
"""

from __future__ import annotations

from collections.abc import Iterable

from agents.sample import NeighbourState
from world.vectors import Vec3


def consensus_error(position: Vec3, desired: Vec3, b: float, heard: Iterable[NeighbourState]) -> tuple[Vec3, float]:
    """e_i = sum_j a_ij (pos_i - pos_j - Delta_ij) + b_i (pos_i - pd_i), and c_i.

    A neighbour that is not in `heard` counts neither in e_i nor in c_i.

    Args:
        position: own position pos_i [m, NED].
        desired: pd_i [m, NED].
        b: b_i [1].
        heard: the neighbours heard so far.

    Returns:
        e_i [m, NED] and c_i [1].
    """
    x, y, z = position
    dx, dy, dz = desired
    ex = b * (x - dx)
    ey = b * (y - dy)
    ez = b * (z - dz)
    c = b
    for _, a, (ox, oy, oz), (px, py, pz), _, _, _, _ in heard:
        ex += a * (x - px - ox)
        ey += a * (y - py - oy)
        ez += a * (z - pz - oz)
        c += a
    return (ex, ey, ez), c
