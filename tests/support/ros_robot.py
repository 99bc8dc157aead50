"""A program of a robot, with a library of ROS 2 by another author and nothing of ours; it is started as a process.

python ros_robot.py talk PORT             a topic /fleet/chatter ten times a second, and a service /fleet/set
python ros_robot.py listen PORT SECONDS   what it hears, what it finds, and what a call answers, as JSON;
                                          it waits so long for each of the three
"""

import json
import os
import sys
import time
from typing import Any

import zenoh_ros2_sdk as sdk

REQUEST, RESPONSE = "bool data\n", "bool success\nstring message\n"
TOPIC, SERVICE = ("/fleet/chatter", "std_msgs/msg/String"), ("/fleet/set", "std_srvs/srv/SetBool")


def talk(port: int) -> None:
    where = {"router_port": port, "domain_id": 0}
    server: Any = sdk.ROS2ServiceServer(
        *SERVICE,
        lambda asked: server.response_msg_class(success=asked.data, message="done"),
        REQUEST,
        RESPONSE,
        **where,
    )
    talker = sdk.ROS2Publisher(*TOPIC, msg_definition="string data\n", **where)
    for count in range(100_000):
        talker.publish(data=f"{count} {time.monotonic()}")
        time.sleep(0.1)


def listen(port: int, seconds: float) -> None:
    where = {"router_port": port, "domain_id": 0}
    delays: list[float] = []
    sdk.ROS2Subscriber(
        *TOPIC,
        lambda message: delays.append(time.monotonic() - float(message.data.split()[1])),
        "string data\n",
        **where,
    )
    deadline = time.monotonic() + seconds
    while not delays and time.monotonic() < deadline:
        time.sleep(0.01)
    services = {}
    deadline = time.monotonic() + seconds
    while not services and time.monotonic() < deadline:
        services = dict(sdk.get_service_names_and_types(domain_id=0, router_port=port, timeout=seconds))
    client = sdk.ROS2ServiceClient(*SERVICE, REQUEST, RESPONSE, timeout=seconds, **where)
    began = time.monotonic()
    answer = client.call(data=True)
    took = time.monotonic() - began
    found = {"delays": delays, "services": services, "answer": answer is not None and answer.message, "took": took}
    print(json.dumps(found), flush=True)
    os._exit(0)  # its threads would keep it


if __name__ == "__main__":
    {"talk": talk, "listen": listen}[sys.argv[1]](*(float(a) if "." in a else int(a) for a in sys.argv[2:]))  # type: ignore[operator]
