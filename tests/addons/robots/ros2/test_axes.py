"""Axes of ROS against cases that were worked out by hand, and against the rotation matrices themselves."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.robots.ros2.mapping import attitude, body, frd, pose_covariance
from fleet.recorder.transforms import enu, quaternion

ANGLES = st.floats(-1.5, 1.5)
H = sqrt(0.5)


def turned(q: tuple[float, ...], v: tuple[float, ...]) -> np.ndarray:
    """A vector in the outer frame."""
    x, y, z, w = q
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return R @ np.array(v)


@pytest.mark.parametrize(
    ("theta", "psi", "phi", "expected"),
    [
        (0.0, pi / 2, 0.0, (0.0, 0.0, 0.0, 1.0)),  # heads east, which is x
        (0.0, 0.0, 0.0, (0.0, 0.0, H, H)),  # north: a quarter turn about up
        (0.0, pi, 0.0, (0.0, 0.0, -H, H)),  # south
        (pi / 6, pi / 2, 0.0, (0.0, -sin(pi / 12), 0.0, cos(pi / 12))),  # east, nose up: about port, negative
        (0.0, pi / 2, pi / 6, (sin(pi / 12), 0.0, 0.0, cos(pi / 12))),  # east, starboard down: about forward
    ],
)
def test_attitudes_by_hand(theta: float, psi: float, phi: float, expected: tuple[float, ...]) -> None:
    assert attitude(theta, psi, phi) == pytest.approx(expected, abs=1e-12)


def test_vectors_by_hand() -> None:
    assert enu((10.0, 2.0, 5.0)) == (2.0, 10.0, -5.0)  # 10 m north, 2 m east, 5 m deep
    assert body((1.0, 0.2, 0.3)) == (1.0, -0.2, -0.3)  # to starboard and down
    assert frd(body((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)


@given(ANGLES, ANGLES, ANGLES, st.tuples(*[st.floats(-9.0, 9.0)] * 3))
def test_a_vector_of_the_body_points_the_same_way(theta: float, psi: float, phi: float, v: tuple) -> None:
    """enu(R v) is the new attitude applied to the vector in the body's new axes."""
    assert turned(attitude(theta, psi, phi), body(v)) == pytest.approx(
        enu(tuple(turned(quaternion(theta, psi, phi), v))), abs=1e-9
    )


@given(st.lists(st.floats(-3.0, 3.0), min_size=16, max_size=16), st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_a_covariance_gives_every_direction_the_same_variance(values: list[float], a: tuple[float, ...]) -> None:
    """a P a is that of the same direction in the other axes; P is positive semidefinite."""
    M = np.array(values).reshape(4, 4)
    P = M @ M.T
    C = np.array(pose_covariance(P[np.triu_indices(4)])).reshape(6, 6)
    east, north, up, yaw = a[1], a[0], -a[2], -a[3]
    b = np.array([east, north, up, 0.0, 0.0, yaw])
    assert b @ C @ b == pytest.approx(np.array(a) @ P @ np.array(a), abs=1e-9)
