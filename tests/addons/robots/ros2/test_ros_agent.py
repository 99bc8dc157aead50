"""A node of ROS 2 as the agent of a vehicle: what it gets, what it may answer, and a run with one."""

from __future__ import annotations

import subprocess
import sys
from math import nan, pi
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from live import LiveRun
from msgspec.structs import replace
from repository import ROOT
from ros_session import ros_node, ros_router
from small_scenario import small
from traffic import LIMIT_S, Command
from waiting import wait_for

from agents.plugged_agent import MAX_PAYLOAD_BYTES
from fleet.addons.robots.ros2.agent import ODOMETRY, PACKET, WRENCH, RosAgent
from fleet.addons.robots.ros2.node import RosNode
from fleet.addons.robots.ros2.types import types_of
from fleet.logs.open_log import open_log
from fleet.mcap.reader import digest
from netem.clock import Clock
from netem.wire.messages import Delivery, Nav
from netem.wire.ros_bus import SETTINGS

pytest.importorskip("rosbags", reason="the extra [ros2] is not installed")

NAV_STATE = (3.0, 2.0, 5.0, 0.1, 0.0), (0.5, 0.1, 0.2, 0.01, 0.02)


class Pilot:
    """A node that answers each odometry with what a test says, and keeps what it gets."""

    def __init__(self, node: RosNode) -> None:
        self.node, self.types = node, node.types
        self.odometry: list[Any] = []
        self.packets: list[Any] = []
        self.answers: list[list[tuple[int, tuple[float, float, float]]]] = []  # to each: stamps later, and wrench
        below = "/uuv_2/agent"
        self._wrench = node.publisher(f"{below}/wrench", WRENCH, drop=False)
        self._tx = node.publisher(f"{below}/tx", PACKET, drop=False)
        node.subscribe(f"{below}/odom", ODOMETRY, self._answer)
        node.subscribe(f"{below}/rx", PACKET, self.packets.append)

    def say(self, data: bytes) -> None:
        import numpy as np

        new = self.types.new
        stamp = new("builtin_interfaces/msg/Time", sec=0, nanosec=0)
        age = new("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        header = new("std_msgs/msg/Header", stamp=stamp, frame_id="")
        self._tx.publish(new(PACKET, header=header, sender=0, age=age, range=0.0, data=np.frombuffer(data, np.uint8)))

    def _answer(self, message: Any) -> None:
        self.odometry.append(message)
        new = self.types.new
        for later, (x, y, z) in self.answers.pop(0):
            stamp = new("builtin_interfaces/msg/Time", sec=message.header.stamp.sec + later,
                        nanosec=message.header.stamp.nanosec)  # fmt: skip
            force, torque = (new("geometry_msgs/msg/Vector3", **dict(zip("xyz", v, strict=True)))
                             for v in ((x, 0.0, 0.0), (0.0, y, z)))  # fmt: skip
            wrench = new("geometry_msgs/msg/Wrench", force=force, torque=torque)
            header = new("std_msgs/msg/Header", stamp=stamp, frame_id="")
            self._wrench.publish(new(WRENCH, header=header, wrench=wrench))


def test_what_a_node_gets_and_answers() -> None:
    """In lockstep: axes, limits, packets before the odometry; answers twice, to nothing, and no numbers."""
    told: list[str] = []
    config = small().agent_config(2)
    x, y, z = config.tau_max
    with ros_router() as (bus, endpoint), ros_node(endpoint, "pilot") as node:
        agent = RosAgent(RosNode(bus, types_of(), 0, "uuv_2_agent"), 2, told.append)
        waiting = Thread(target=agent.wait_for_node)
        waiting.start()
        wait_for(lambda: told, LIMIT_S, "a word")
        pilot = Pilot(node)
        waiting.join(LIMIT_S)
        assert not waiting.is_alive()
        agent.begin(config, Clock.LOCKSTEP)
        pilot.answers = [
            [(0, (0.5 * x, 0.25 * y, -0.5 * z))],
            [(0, (9 * x, -9 * y, 0.0)), (0, (0.0, 0.0, 0.0))],
            [(7, (0.0, 0.0, 0.0)), (0, (nan, 0.0, 0.0))],
        ]
        delivery = Delivery(10, 5, 1, 0, 0, b"hello")
        assert agent.decide(Nav(0, 10, *NAV_STATE), [delivery]).tau == (0.5 * x, -0.25 * y, 0.5 * z)
        (odometry,), (packet,) = pilot.odometry, wait_for(lambda: pilot.packets, LIMIT_S, "the packet")
        place, turn, moves = odometry.pose.pose.position, odometry.pose.pose.orientation, odometry.twist.twist
        assert (place.x, place.y, place.z) == (2.0, 3.0, -5.0)
        assert (moves.linear.y, moves.angular.z) == (-0.1, -0.02)
        assert turn.z == pytest.approx(pi / 4, abs=0.1)  # it heads north
        assert (packet.sender, bytes(packet.data)) == (1, b"hello")
        assert packet.age.sec * 10**9 + packet.age.nanosec == 5 * config.tick_ns
        assert packet.range != packet.range
        measured = replace(delivery, range_m=12.5, range_sd_m=0.1, range_tick=5)
        assert agent.decide(Nav(0, 11, *NAV_STATE), [measured]).tau == (x, y, 0.0)
        assert wait_for(lambda: pilot.packets[1:], LIMIT_S, "the packet with a range")[0].range == 12.5
        assert agent.decide(Nav(0, 12, *NAV_STATE), []).tau == (x, y, 0.0)
        texts = [text for _, text in agent.take_notes()]
        for text, words in zip(texts, ("stamp twice", "stamp of no odometry", "what is no number"), strict=True):
            assert words in text
        for data in (b"a", b"b", bytes(MAX_PAYLOAD_BYTES)):
            pilot.say(data)
        wait_for(lambda: agent._sent.qsize() == 3, LIMIT_S, "three packets")
        assert agent.transmit(Nav(0, 15, *NAV_STATE)) == (b"a", b"b")
        assert "more than 40000 bytes" in agent.take_notes()[0][1]
        assert agent.transmit(Nav(0, 20, *NAV_STATE)) == ()


def test_on_a_wall_clock_the_newest_wrench_holds() -> None:
    with ros_router() as (bus, endpoint), ros_node(endpoint, "pilot") as node:
        agent = RosAgent(RosNode(bus, types_of(), 0, "uuv_2_agent"), 2, lambda _: None)
        pilot = Pilot(node)
        agent.wait_for_node()
        agent.begin(small().agent_config(2), Clock.REAL)
        pilot.answers = [[(0, (1.0, 0.0, 0.0)), (0, (2.0, 0.0, 0.0))], []]
        assert agent.decide(Nav(0, 10, *NAV_STATE), []).tau[0] in (0.0, 1.0, 2.0)  # it waits for nobody
        wait_for(lambda: agent._answers.qsize() or len(pilot.odometry) == 1, LIMIT_S, "answers")
        wait_for(lambda: agent._answers.qsize() + (agent._tau[0] > 0) >= 1, LIMIT_S, "an answer")
        agent.decide(Nav(0, 11, *NAV_STATE), [])
        wait_for(lambda: len(pilot.odometry) == 2, LIMIT_S, "the second odometry")
        assert agent._tau[0] in (1.0, 2.0)


@pytest.mark.slow
def test_a_run_with_a_foreign_node_is_the_same_twice(tmp_path: Path) -> None:
    """The node of the example has no code of ours; its packets go through the impaired network."""
    logs = []
    with ros_router() as (_, endpoint):
        environment = {SETTINGS: f'mode="client";connect/endpoints=["{endpoint}"]'}
        for number in range(2):
            settings = ("vehicles=3", "duration=1 s", "checks={}", "per_vehicle={3: {external: true}}")
            words = ("paper", *(word for text in settings for word in ("--set", text)), "--quiet")
            with LiveRun(tmp_path / str(number), *words) as run:
                wait_for(lambda run=run: (run.out / "latest" / "join-3.json").exists() or run.over, LIMIT_S, "the file")
                node = subprocess.Popen([sys.executable, ROOT / "docs/examples/ros2_node.py", "3", endpoint])
                try:
                    words = ("agent", "--join", run.directory / "join-3.json", "--ros2")
                    with Command(*words, environment=environment) as agent:
                        assert run.status() == 0, run.printed + agent.printed
                        assert agent.status() == 0
                finally:
                    node.kill()
                    node.wait(LIMIT_S)
                logs.append(run.log)
    assert digest(logs[0]) == digest(logs[1])
    log = open_log(logs[0])
    heard = log["link/3-2"]
    assert any(payload.startswith(b"3 ") for payload in heard.payload)
    assert log["uuv/3/command"].tau[:, 0].any()
