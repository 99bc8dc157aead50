"""The desired motion of a vehicle that does not know the reference, computed from its neighbours' states.

| symbol | meaning | unit | frame |
|---|---|---|---|
| a_ij | weight of neighbour j | 1 | - |
| Delta_ij(t), Delta_ij'(t) | desired offset p_i - p_j, and its rate of change | m, m/s | NED |
| pos_j, vel_j | neighbour j's position, extrapolated to now, and its velocity when it sent | m, m/s | NED |

The desired position is the weighted mean of pos_j + Delta_ij over the neighbours j. The desired velocity is the
weighted mean of vel_j + Delta_ij'. If the sum of the weights is 0 (no neighbour heard yet, or all dropped), the desired
position is the vehicle's own position and the desired velocity is 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from agents.offset import Offset
from agents.sample import NeighbourState
from agents.trajectory import Motion
from world.vectors import Vec3


def followed(position: Vec3, heard: Iterable[NeighbourState], offsets: Mapping[int, Offset], t: float) -> Motion:
    """The desired position and velocity of a vehicle, from the states of the neighbours that it has heard.

    Args:
        position: its own position [m, NED].
        heard: the neighbours heard so far. Neighbours with an outdated state are left out.
        offsets: Delta_ij [m, NED] of each neighbour in `heard`, by its number j.
        t: time by the vehicle's clock [s].

    Returns:
        Position [m, NED] and velocity [m/s, NED].
    """
    total = x = y = z = vx = vy = vz = 0.0
    for j, a, (ox, oy, oz), (px, py, pz), (ux, uy, uz), _, _, _ in heard:
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
