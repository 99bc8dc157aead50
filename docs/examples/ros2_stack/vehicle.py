"""A node of ROS 2 that dives to the set point that it has heard last, and tells its depth: by zenoh-ros2-sdk.

python vehicle.py ROUTER   such as tcp/127.0.0.1:7501
"""

import sys
import time

import zenoh_ros2_sdk as sdk

STEP_S, SPEED = 0.1, 4.0  # [s], [m/s]
FLOAT = ("std_msgs/msg/Float64", "float64 data\n")

wanted, depth = 0.0, 0.0


def hear(message) -> None:
    global wanted
    wanted = message.data


where = {"router_port": int(sys.argv[1].rpartition(":")[2]), "domain_id": 0}
sdk.ROS2Subscriber("/fleet/set_depth", FLOAT[0], hear, FLOAT[1], **where)
teller = sdk.ROS2Publisher("/vehicle/depth", *FLOAT, **where)
while True:
    depth += max(-SPEED * STEP_S, min(SPEED * STEP_S, wanted - depth))
    teller.publish(data=depth)
    time.sleep(STEP_S)
