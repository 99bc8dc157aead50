"""A router for nodes of ROS 2 on a free port, and what another program would open there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from free_ports import free_port

from fleet.ros2.node import RosNode
from fleet.ros2.types import types_of
from netem.wire.ros_bus import RosBus


@contextmanager
def ros_router() -> Iterator[tuple[RosBus, str]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    bus = RosBus.be_router(endpoint)
    try:
        yield bus, endpoint
    finally:
        bus.close()


@contextmanager
def ros_node(endpoint: str, name: str, domain: int = 0, distribution: str = "jazzy") -> Iterator[RosNode]:
    """A node of ours that has joined."""
    bus = RosBus.join(endpoint)
    try:
        yield RosNode(bus, types_of(distribution), domain, name)
    finally:
        bus.close()


@contextmanager
def foreign_session(endpoint: str) -> Iterator[Any]:
    """A zenoh session with nothing of ours."""
    config = zenoh.Config()
    for key, value in {
        "mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()
