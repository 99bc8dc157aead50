"""The node `vehicle`: a vehicle's topics of ROS 2, beside the nodes of its user, as a process of the same agent.

It needs rclpy and nothing of uuv-fleet, since it runs in the Python of the user's nodes. The agent sends where the
vehicle is to UDP port 14560, as a line of JSON; what is commanded goes to port 14561.

| topic | type | |
|---|---|---|
| `odom` | nav_msgs/Odometry | east, north, up; forward, port, up (REP 103, 105) |
| `wrench` | geometry_msgs/WrenchStamped or Wrench | `force.x`, `torque.y`, `torque.z` |
| `cmd_vel` | geometry_msgs/TwistStamped or Twist | `linear.x`, `angular.y`, `angular.z` |

Others do not see these topics: it looks for nodes on its own host alone, and answers no other.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from math import cos, pi, sin
from typing import Any

import rclpy
from geometry_msgs.msg import Twist, TwistStamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy

HOST, TOLD_AT, COMMANDED_AT = "127.0.0.1", 14560, 14561
NS = 10**9
# Of east, north, up, yaw: which of x, y, z, psi each is, with which sign, and its row in a covariance of ROS.
_AXES = ((1, 1.0, 0), (0, 1.0, 1), (2, -1.0, 2), (3, -1.0, 5))


def half_turn(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Forward, starboard, down as forward, port, up, and back: a half turn."""
    return x, -y, -z


def attitude(theta: float, psi: float, phi: float = 0.0) -> tuple[float, float, float, float]:
    """(x, y, z, w) that turns forward, port, up into east, north, up, by pitch, yaw and roll [rad] in our axes."""
    theta, psi = -theta, pi / 2 - psi
    ct, st, cp, sp = cos(theta / 2), sin(theta / 2), cos(psi / 2), sin(psi / 2)
    x, y, z, w = -sp * st, cp * st, sp * ct, cp * ct
    if not phi:
        return x, y, z, w
    c, s = cos(phi / 2), sin(phi / 2)
    return c * x + s * w, c * y + s * z, c * z - s * y, c * w - s * x


def covariance(upper: Iterable[float]) -> list[float]:
    """36 values, of the covariance of x, y, z, psi in our axes: its upper triangle, row by row."""
    values, P = iter(upper), {}
    for i in range(4):
        for j in range(i, 4):
            P[i, j] = P[j, i] = float(next(values))
    found = [0.0] * 36
    for i, s, row in _AXES:
        for j, t, column in _AXES:
            found[6 * row + column] = s * t * P[i, j]
    return found


def odometry(told: Mapping[str, Any], number: int, epoch_s: int) -> Any:
    """The message of what the agent has told."""
    message, ns = Odometry(), round(told["t"] * NS)
    message.header.stamp.sec, message.header.stamp.nanosec = epoch_s + ns // NS, ns % NS
    message.header.frame_id, message.child_frame_id = "map", f"uuv_{number}/base_link"
    pose, twist = message.pose.pose, message.twist.twist
    north, east, down = map(float, told["position"])
    _set(pose.position, "xyz", (east, north, -down))
    _set(pose.orientation, "xyzw", attitude(told["theta"], told["psi"], told.get("phi", 0.0)))
    _set(twist.linear, "xyz", half_turn(*map(float, told["velocity"])))
    _set(twist.angular, "xyz", half_turn(*map(float, (told.get("p", 0.0), told["q"], told["r"]))))
    if told.get("covariance"):
        message.pose.covariance = covariance(told["covariance"])
    return message


def _set(message: Any, names: str, values: Iterable[float]) -> None:
    for name, value in zip(names, values, strict=True):
        setattr(message, name, value)


def wrench_command(message: Any) -> dict[str, float]:
    """What a wrench commands."""
    wrench = getattr(message, "wrench", message)
    _, pitch, yaw = half_turn(0.0, wrench.torque.y, wrench.torque.z)
    return {"force": wrench.force.x, "pitch": pitch, "yaw": yaw}


def velocity_command(message: Any) -> dict[str, float]:
    """What a twist commands."""
    twist = getattr(message, "twist", message)
    _, pitch, yaw = half_turn(0.0, twist.angular.y, twist.angular.z)
    return {"surge": twist.linear.x, "pitch_rate": pitch, "yaw_rate": yaw}


class Commands:
    """A topic of commands, which has one of two types: that of whoever publishes there."""

    def __init__(self, node: Any, topic: str, types: Iterable[Any], hear: Callable[[Any], None]) -> None:
        self._node, self._topic, self._hear = node, node.resolve_topic_name(topic), hear
        self._types = {f"geometry_msgs/msg/{each.__name__}": each for each in types}
        self._subscription: Any = None
        self._type = ""

    def look(self) -> None:
        """Subscribe with the type that is published: a node can have one type for a topic at a time."""
        if self._subscription is not None and self._subscription.get_publisher_count():
            return
        found = [each.topic_type for each in self._node.get_publishers_info_by_topic(self._topic)]
        new = next((each for each in found if each in self._types), self._type)
        if new == self._type:
            return
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        # Best effort hears publishers of either kind, and nothing is lost within a host.
        qos = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._type = new
        self._subscription = self._node.create_subscription(self._types[new], self._topic, self._hear, qos)


class RosVehicle:
    """Tells where the vehicle is, and hears what it is to do."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, TOLD_AT))
        self.node = Node("vehicle", start_parameter_services=False, enable_rosout=False)
        self._odometry = self.node.create_publisher(Odometry, "odom", 10)
        self._commands = [
            Commands(self.node, "wrench", (WrenchStamped, Wrench), lambda heard: self._send(wrench_command(heard))),
            Commands(self.node, "cmd_vel", (TwistStamped, Twist), lambda heard: self._send(velocity_command(heard))),
        ]

    def _send(self, command: Mapping[str, float]) -> None:
        self._socket.sendto(json.dumps(command).encode() + b"\n", (HOST, COMMANDED_AT))

    def tell(self) -> None:
        """Publish what comes, until the end."""
        epoch_s = None
        try:
            while rclpy.ok():
                told = json.loads(self._socket.recv(65536))
                if epoch_s is None:  # the time of a run begins at a whole second
                    epoch_s = round(self.node.get_clock().now().nanoseconds / NS - told["t"])
                self._odometry.publish(odometry(told, self._number, epoch_s))
                for each in self._commands:
                    each.look()
        finally:
            rclpy.try_shutdown()  # so that the process ends if this thread fails


def main() -> None:
    """Run the node. The first argument: the number of the vehicle."""
    # With it the node neither sends nor hears multicast: nodes of other hosts never learn of it.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    for name in ("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"):
        os.environ.pop(name, None)
    rclpy.init(args=sys.argv)
    vehicle = RosVehicle(int(sys.argv[1]))
    threading.Thread(target=vehicle.tell, daemon=True).start()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(vehicle.node)


if __name__ == "__main__":
    main()
