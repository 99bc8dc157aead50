"""From our axes to those of ROS (REP 103, 105): north, east, down to east, north, up; forward, starboard, down to
forward, port, up.

| symbol | meaning | unit | frame |
|---|---|---|---|
| eta | x, y, z, theta, psi | m, rad | north, east, down |
| nu | u, v, w, q, r over ground | m/s, rad/s | body: forward, starboard, down |
| P | covariance of x, y, z, psi: upper triangle, row by row | m^2, m rad, rad^2 | north, east, down |

Both changes of axes are half turns, about the line north-east and about the forward axis. With R = Rz(psi) Ry(theta)
Rx(phi) from body to north, east, down, the same attitude in the axes of ROS is Rz(pi/2 - psi) Ry(-theta) Rx(phi).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

from fleet.recorder.transforms import quaternion
from world.vectors import Vec3

Quaternion = tuple[float, float, float, float]  # x, y, z, w
HALF_TURN_ABOUT_FORWARD: Quaternion = (1.0, 0.0, 0.0, 0.0)

# Of east, north, up, yaw: which of x, y, z, psi each is, and with which sign.
_AXES = ((1, 1.0), (0, 1.0), (2, -1.0), (3, -1.0))
_PLACES = (0, 1, 2, 5)  # of x, y, z and the turn about z in the covariance of a pose in ROS, which has six rows


def body(frd: Vec3) -> Vec3:
    """A vector in the axes forward, starboard, down in those of ROS: forward, port, up."""
    x, y, z = frd
    return x, -y, -z


frd = body  # a half turn is its own inverse


def attitude(theta: float, psi: float, phi: float = 0.0) -> Quaternion:
    """(x, y, z, w) that turns forward, port, up into east, north, up, by pitch, yaw and roll [rad] in our axes."""
    return quaternion(-theta, pi / 2 - psi, phi)


def pose_covariance(upper: Sequence[float]) -> list[float]:
    """The 36 values of a `PoseWithCovariance`, of P (10,); roll and pitch have none: they are measured as they are."""
    P = [[0.0] * 4 for _ in range(4)]
    values = iter(upper)
    for i in range(4):
        for j in range(i, 4):
            P[i][j] = P[j][i] = next(values)
    found = [0.0] * 36
    for row, (i, s) in zip(_PLACES, _AXES, strict=True):
        for column, (j, t) in zip(_PLACES, _AXES, strict=True):
            found[6 * row + column] = s * t * P[i][j]
    return found
