"""A router for nodes of ROS 2 on a free port, and what another program would open there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import zenoh
from free_ports import free_port

from fleet.addons.robots.ros2.node import RosNode
from fleet.addons.robots.ros2.types import types_of
from netem.wire.ros_bus import RosBus


@contextmanager
def ros_router() -> Iterator[tuple[RosBus, str]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with closing(RosBus.be_router(endpoint)) as bus:
        yield bus, endpoint


@contextmanager
def ros_node(endpoint: str, name: str, domain: int = 0, distribution: str = "jazzy") -> Iterator[RosNode]:
    """A node of ours that has joined."""
    with closing(RosBus.join(endpoint)) as bus:
        yield RosNode(bus, types_of(distribution), domain, name)


@contextmanager
def foreign_session(endpoint: str) -> Iterator[Any]:
    """A zenoh session with nothing of ours."""
    config = zenoh.Config()
    for key, value in {
        "mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    with closing(zenoh.open(config)) as session:
        yield session
