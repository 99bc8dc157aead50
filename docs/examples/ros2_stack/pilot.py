"""A node of ROS 2 that sends a set point of depth, five times a second, without ROS: by zenoh-ros2-sdk.

python pilot.py ROUTER     such as tcp/127.0.0.1:7501
"""

import itertools
import sys
import time

import zenoh_ros2_sdk as sdk

where = {"router_port": int(sys.argv[1].rpartition(":")[2]), "domain_id": 0}
talker = sdk.ROS2Publisher("/fleet/set_depth", "std_msgs/msg/Float64", "float64 data\n", **where)
for count in itertools.count():
    talker.publish(data=10.0 if count < 25 else 20.0)
    time.sleep(0.2)
