"""Where a vehicle that does not know the trajectory should be, from its neighbours and its place among them.

| symbol | meaning | unit | frame |
|---|---|---|---|
| a_ij | weight of neighbour j | 1 | - |
| Delta_ij(t) | desired offset, p_i - p_j | m | NED |
| pos_j, vel_j | neighbour j's position now, as extrapolated, and its velocity when it sent | m, m/s | NED |

The desired position is the weighted mean of pos_j + Delta_ij, the desired velocity that of vel_j + Delta_ij'. A vehicle
that has heard no neighbour, or counts none any more, should stay where it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from agents.api import NeighbourState
from agents.offset import Offset
from agents.trajectory import Motion
from world.vectors import Vec3


def followed(position: Vec3, heard: Iterable[NeighbourState], offsets: Mapping[int, Offset], t: float) -> Motion:
    """The desired position and velocity of a vehicle, from those of the neighbours that it has heard.

    Args:
        position: its own position [m, NED].
        heard: the neighbours heard so far.
        offsets: Delta_ij(t) by neighbour j [m, NED].
        t: time [s].

    Returns:
        Position [m, NED] and velocity [m/s, NED].
    """
    total = x = y = z = vx = vy = vz = 0.0
    for j, a, (ox, oy, oz), (px, py, pz), (ux, uy, uz), _ in heard:
        offset = offsets[j]
        dx, dy, dz = offset.at(t).velocity if offset.changes else (0.0, 0.0, 0.0)
        total += a
        x += a * (px + ox)
        y += a * (py + oy)
        z += a * (pz + oz)
        vx += a * (ux + dx)
        vy += a * (uy + dy)
        vz += a * (uz + dz)
    if total == 0.0:
        return Motion(position, (0.0, 0.0, 0.0))
    return Motion((x / total, y / total, z / total), (vx / total, vy / total, vz / total))
