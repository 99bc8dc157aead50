"""The node `vehicle` of ROS 2: its numbers are those of the bridge. What it does as a process: the corpus."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from fleet.addons.robots.ros2.mapping import MessageMaker
from fleet.addons.robots.ros2.types import RosTypes

pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")
TOLD = {
    "t": 12.345678901, "position": [1.5, -2.0, 30.25], "theta": 0.2, "psi": -2.5, "velocity": [1.0, 0.2, -0.1],
    "q": 0.01, "r": -0.02, "covariance": [4.0, 0.1, 0.2, 0.3, 5.0, 0.4, 0.5, 6.0, 0.6, 7.0],
}  # fmt: skip
PLACES = "position.x", "position.y", "position.z", *(f"orientation.{name}" for name in "xyzw")
MOTIONS = tuple(f"{kind}.{name}" for kind in ("linear", "angular") for name in "xyz")


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program, with modules of ROS of which only the names are there."""
    for name in ("rclpy", "rclpy.executors", "rclpy.node", "rclpy.qos", "geometry_msgs", "geometry_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    monkeypatch.setitem(sys.modules, "nav_msgs", MagicMock())
    monkeypatch.setitem(sys.modules, "nav_msgs.msg", SimpleNamespace(Odometry=empty))
    monkeypatch.delitem(sys.modules, "fleet.addons.programs.ros_vehicle", raising=False)
    return importlib.import_module("fleet.addons.programs.ros_vehicle")


def empty() -> Any:
    """An Odometry whose numbers nobody has set yet."""
    pose = SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace()))
    twist = SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(), angular=SimpleNamespace()))
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace()), pose=pose, twist=twist)


def value(of: Any, path: str) -> float:
    for name in path.split("."):
        of = getattr(of, name)
    return float(of)


@pytest.mark.parametrize("roll", [{}, {"phi": 0.3, "p": 0.05}])
def test_odometry_is_that_of_the_bridge(vehicle: ModuleType, roll: dict[str, float]) -> None:
    told: dict[str, Any] = TOLD | roll
    x, y, z = told["position"]
    u, v, w = told["velocity"]
    state = SimpleNamespace(x=x, y=y, z=z, u=u, v=v, w=w, **{name: told[name] for name in ("theta", "psi", "q", "r")})
    state.phi, state.p = roll.get("phi", 0.0), roll.get("p", 0.0)
    bridge = MessageMaker(RosTypes("jazzy")).odometry(1_767_225_612_345_678_901, 7, state, told["covariance"])
    own = vehicle.odometry(told, 7, 1_767_225_600)
    assert [value(own.pose.pose, each) for each in PLACES] == [value(bridge.pose.pose, each) for each in PLACES]
    assert [value(own.twist.twist, each) for each in MOTIONS] == [value(bridge.twist.twist, each) for each in MOTIONS]
    assert own.pose.covariance == [*bridge.pose.covariance]
    assert (own.header.stamp.sec, own.header.stamp.nanosec) == (1_767_225_612, 345_678_901)
    assert (own.header.frame_id, own.child_frame_id) == (bridge.header.frame_id, bridge.child_frame_id)


def test_commands_are_turned_into_our_axes(vehicle: ModuleType) -> None:
    wrench = SimpleNamespace(force=SimpleNamespace(x=7.0), torque=SimpleNamespace(y=2.0, z=-1.0))
    twist = SimpleNamespace(linear=SimpleNamespace(x=1.5), angular=SimpleNamespace(y=0.1, z=0.2))
    for message in (wrench, SimpleNamespace(wrench=wrench)):
        assert vehicle.wrench_command(message) == {"force": 7.0, "pitch": -2.0, "yaw": 1.0}
    for message in (twist, SimpleNamespace(twist=twist)):
        assert vehicle.velocity_command(message) == {"surge": 1.5, "pitch_rate": -0.1, "yaw_rate": -0.2}
