"""The same node for ROS 2 itself: `python ros2_node_rclpy.py 3`, with `rclpy` and a built `uuv_fleet_msgs`.

Written from the documents of ROS and NOT RUN: ROS was not at hand. `fleet ros2 --interfaces` writes the package."""

import sys
from math import atan2, remainder, tau

import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from uuv_fleet_msgs.msg import Packet


class Pilot(Node):
    """Heads east at 0.5 m/s at the depth and on the line where it began, and tells its neighbours where it is."""

    def __init__(self, vehicle):
        super().__init__(f"pilot_{vehicle}")
        below = f"/uuv_{vehicle}/agent"
        self.vehicle, self.start, self.heard = vehicle, None, {}
        self.wrench = self.create_publisher(WrenchStamped, f"{below}/wrench", 10)
        self.tx = self.create_publisher(Packet, f"{below}/tx", 10)
        self.create_subscription(Packet, f"{below}/rx", self.receive, 100)
        self.create_subscription(Odometry, f"{below}/odom", self.answer, 10)

    def receive(self, packet):
        self.heard[packet.sender] = bytes(packet.data)

    def answer(self, odometry):
        at, q, moves = odometry.pose.pose.position, odometry.pose.pose.orientation, odometry.twist.twist
        start = self.start = self.start or at
        yaw = atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
        down = 2 * (q.w * q.y - q.z * q.x)  # sine of the pitch; positive: nose down
        course = max(-0.5, min(0.5, 0.2 * (start.y - at.y)))
        dive = max(-0.3, min(0.3, 0.2 * (at.z - start.z)))
        if odometry.header.stamp.nanosec % 100_000_000 == 0:
            packet = Packet()
            packet.data = f"{self.vehicle} {at.x:.2f} {at.y:.2f} {at.z:.2f}".encode()
            self.tx.publish(packet)
        answer = WrenchStamped()
        answer.header.stamp = odometry.header.stamp  # one answer to each odometry
        answer.wrench.force.x = 40 * (0.5 - moves.linear.x)
        answer.wrench.torque.y = 15 * (dive - down) - 10 * moves.angular.y
        answer.wrench.torque.z = 15 * remainder(course - yaw, tau) - 10 * moves.angular.z
        self.wrench.publish(answer)


rclpy.init()
rclpy.spin(Pilot(int(sys.argv[1])))
