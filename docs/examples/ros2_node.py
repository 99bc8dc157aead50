"""A node of ROS 2 that commands a vehicle, without ROS: `python ros2_node.py 3 tcp/127.0.0.1:7447`.

It needs `zenoh`, and `rosbags` for types and CDR, and nothing of uuv-fleet: it speaks what rmw_zenoh speaks. It heads
east at 0.5 m/s at the depth and on the line where it began, and tells its neighbours where it is. One answer to each
odometry, with its stamp, keeps the run in lockstep."""

import json
import os
import struct
import sys
import threading
import time
from math import atan2, remainder, tau

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PACKET = """std_msgs/Header header
uint32 sender
builtin_interfaces/Duration age
float64 range
uint8[] data
"""
ODOMETRY, WRENCH, OURS = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped", "uuv_fleet_msgs/msg/Packet"
vehicle, endpoint = int(sys.argv[1]), sys.argv[2]
domain, below = os.environ.get("ROS_DOMAIN_ID", "0"), f"/uuv_{vehicle}/agent"
store = get_typestore(Stores.ROS2_JAZZY)
store.register(get_types_from_msg(PACKET, OURS))
Header, Time, Duration, Vector3, Wrench = (
    store.types[name]
    for name in (
        *("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"),
        *("geometry_msgs/msg/Vector3", "geometry_msgs/msg/Wrench"),
    )
)
config = zenoh.Config()
for name, value in {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}.items():
    config.insert_json5(name, json.dumps(value))
session = zenoh.open(config)
here = f"@ros2_lv/{domain}/{session.zid()}/0"
tokens = [session.liveliness().declare_token(f"{here}/0/NN/%/%/pilot_{vehicle}")]


def declare(topic, kind, way):
    """A publisher (MP) or subscription (MS) for others to see; the key on which its messages travel."""
    package, _, short = kind.split("/")
    typed = f"{package}::msg::dds_::{short}_/{store.hash_rihs01(kind)}"
    token = f"{here}/{len(tokens)}/{way}/%/%/pilot_{vehicle}/{topic.replace('/', '%')}/{typed}/::,10:,:,:,,"
    tokens.append(session.liveliness().declare_token(token))
    return f"{domain}{topic}/{typed}"


def publisher(topic, kind):
    put = session.declare_publisher(declare(topic, kind, "MP"), congestion_control=zenoh.CongestionControl.BLOCK).put
    gid, sent = os.urandom(16), 0

    def publish(**fields):
        nonlocal sent
        sent += 1
        attachment = struct.pack("<qqB16s", sent, time.time_ns(), 16, gid)  # noqa: TID251 (as ROS does)
        put(bytes(store.serialize_cdr(store.types[kind](**fields), kind)), attachment=attachment)

    return publish


def law(odometry):
    """Force and moments [N, N m] in the axes forward, port, up."""
    at, q, moves = odometry.pose.pose.position, odometry.pose.pose.orientation, odometry.twist.twist
    yaw = atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    down = 2 * (q.w * q.y - q.z * q.x)  # sine of the pitch; positive: nose down
    course = max(-0.5, min(0.5, 0.2 * (start[0].y - at.y)))
    dive = max(-0.3, min(0.3, 0.2 * (at.z - start[0].z)))
    pitch, turn = dive - down, remainder(course - yaw, tau)
    torque = Vector3(x=0.0, y=15 * pitch - 10 * moves.angular.y, z=15 * turn - 10 * moves.angular.z)
    return Wrench(force=Vector3(x=40 * (0.5 - moves.linear.x), y=0.0, z=0.0), torque=torque)


def receive(sample):
    packet = store.deserialize_cdr(sample.payload.to_bytes(), OURS)
    heard[packet.sender] = bytes(packet.data)


def answer(sample):
    odometry = store.deserialize_cdr(sample.payload.to_bytes(), ODOMETRY)
    stamp, at = odometry.header.stamp, odometry.pose.pose.position
    start.append(at)
    header = Header(stamp=stamp, frame_id=f"uuv_{vehicle}/base_link")
    if stamp.nanosec % 100_000_000 == 0:  # before the wrench: it answers all that came before
        text = f"{vehicle} {at.x:.2f} {at.y:.2f} {at.z:.2f}, heard {sorted(heard)}"
        age, data = Duration(sec=0, nanosec=0), np.frombuffer(text.encode(), np.uint8)
        tx(header=header, sender=vehicle, age=age, range=0.0, data=data)
    wrench(header=header, wrench=law(odometry))


start, heard = [], {}
wrench, tx = publisher(f"{below}/wrench", WRENCH), publisher(f"{below}/tx", OURS)
subscribers = [
    session.declare_subscriber(declare(f"{below}/{topic}", kind, "MS"), handler)
    for topic, kind, handler in (("rx", OURS, receive), ("odom", ODOMETRY, answer))
]
print(f"node for vehicle {vehicle} at {endpoint}, until Ctrl-C", flush=True)
threading.Event().wait()
