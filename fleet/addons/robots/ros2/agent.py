"""A node of ROS 2 as the agent of a vehicle: what it measures and receives goes out, a wrench and packets come back.

| topic below `/uuv_<i>/agent` | direction | content |
|---|---|---|
| `odom` | to the node | what the vehicle measures or believes, once a tick; its stamp is the time of the run |
| `rx` | to the node | each packet that it may use from this tick on, before the `odom` of the tick |
| `wrench` | from the node | force and moments in `base_link`, with the stamp of the `odom` that it answers |
| `tx` | from the node | bytes for every neighbour; they leave at the next round |
| `config` | to the node, kept | the agent's slice of the scenario as JSON |

In lockstep the vehicle waits for the answer to each odometry, so the run is as deterministic as the node. On a wall
clock it waits for nothing, and the newest wrench holds.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from math import isfinite, nan
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from agents.config import AgentConfig
from agents.laws.velocity_command import clip
from agents.plugged_agent import MAX_PAYLOAD_BYTES
from agents.sample import Decision
from fleet.addons.robots.ros2.mapping import MessageMaker, base_link, frd
from fleet.addons.robots.ros2.node import RosNode
from fleet.addons.robots.ros2.rmw import LATCHED
from fleet.addons.robots.ros2.types import OWN
from netem.clock import Clock
from netem.wire.messages import Delivery, Nav
from world.vectors import Vec3

ODOMETRY, WRENCH, PACKET = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped", f"{OWN}/msg/Packet"
TELL_S = 5.0  # between two words that nobody answers
POLL_S = 0.1
_Stamp = tuple[int, int]  # s, ns


class NavState:
    """A nav by the names of the signals of a state."""

    def __init__(self, nav: Nav) -> None:
        self.x, self.y, self.z, self.theta, self.psi = nav.eta
        self.u, self.v, self.w, self.q, self.r = nav.nu
        self.phi, self.p = nav.roll or (0.0, 0.0)


class RosAgent:
    """Stands between the run and the node; see `agents.loop.AgentCore`."""

    def __init__(self, node: RosNode, vehicle: int, tell: Callable[[str], None]) -> None:
        """Declare the topics. `tell`: called with a line for the user. Raises FleetError: a type is not known."""
        self._node, self._vehicle, self._tell = node, vehicle, tell
        self._make = MessageMaker(node.types)
        below = f"/uuv_{vehicle}/agent"
        self._wrench_topic = f"{below}/wrench"
        self._odom = node.publisher(f"{below}/odom", ODOMETRY, drop=False)
        self._rx = node.publisher(f"{below}/rx", PACKET, drop=False)
        self._config = node.publisher(f"{below}/config", "std_msgs/msg/String", LATCHED)
        self._answers: SimpleQueue[tuple[_Stamp, Vec3]] = SimpleQueue()
        self._sent: SimpleQueue[bytes] = SimpleQueue()
        node.subscribe(self._wrench_topic, WRENCH, self._answer)
        node.subscribe(f"{below}/tx", PACKET, lambda packet: self._sent.put(bytes(packet.data)))
        self._tau: Vec3 = (0.0, 0.0, 0.0)
        self._answered: _Stamp = (-1, 0)
        self._notes: list[tuple[int, str]] = []
        self._noted: set[str] = set()

    def wait_for_node(self) -> None:
        """Until a node subscribes to `odom` and publishes `wrench`."""
        told = False
        while not (self._odom.matched and self._node.publishers_of(self._wrench_topic)):
            if not told:
                told = True
                below = f"/uuv_{self._vehicle}/agent"
                self._tell(f"waiting for a node that subscribes to {below}/odom and publishes {below}/wrench")
            time.sleep(POLL_S)
            self._tell_problems()

    def begin(self, config: AgentConfig, clock: Clock) -> RosAgent:
        self._settings, self._waits = config, clock is Clock.LOCKSTEP
        x, y, z = config.tau_max
        self._limits: tuple[Vec3, Vec3] = ((-x, -y, -z), (x, y, z))
        self._config.publish(self._node.types.new("std_msgs/msg/String", data=json.dumps(config.to_values())))
        return self

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The node's messages since the round before, as many as fit into a round."""
        payloads, size = [], 0
        while not self._sent.empty():
            payload = self._sent.get()
            size += len(payload)
            if size > MAX_PAYLOAD_BYTES:
                self._note(nav.tick, f"its node sends more than {MAX_PAYLOAD_BYTES} bytes in a round: the rest is lost")
                continue
            payloads.append(payload)
        return tuple(payloads)

    def decide(self, nav: Nav, deliveries: list[Delivery]) -> Decision:
        ns = nav.tick * self._settings.tick_ns
        for delivery in deliveries:
            self._rx.publish(self._received(nav, delivery))
        self._odom.publish(self._make.odometry(ns, self._vehicle, NavState(nav), nav.belief))
        self._take(nav.tick, (ns // 10**9, ns % 10**9))
        self._tell_problems()
        return Decision(clip(self._tau, *self._limits), ())

    def _received(self, nav: Nav, delivery: Delivery) -> Any:
        age_ns = max(0, nav.tick - delivery.sent_tick) * self._settings.tick_ns
        return self._node.types.new(
            PACKET,
            header=self._make.header(delivery.sent_tick * self._settings.tick_ns, base_link(delivery.src)),
            sender=delivery.src,
            age=self._node.types.new("builtin_interfaces/msg/Duration", sec=age_ns // 10**9, nanosec=age_ns % 10**9),
            range=nan if delivery.range_m is None else delivery.range_m,
            data=np.frombuffer(delivery.payload, np.uint8),
        )

    def _take(self, tick: int, stamp: _Stamp) -> None:
        """Take answers: in lockstep wait for the answer to this stamp, on a wall clock take those that have come."""
        tell_s = time.monotonic() + TELL_S
        while True:
            try:
                at, tau = self._answers.get(self._waits, POLL_S if self._waits else None)
            except Empty:
                if not self._waits:
                    return
                if time.monotonic() >= tell_s:
                    tell_s += TELL_S
                    self._tell(f"no wrench with stamp {stamp[0]}.{stamp[1]:09d} on {self._wrench_topic} yet")
                    self._tell_problems()
                continue
            if self._waits and at != stamp:
                again = at == self._answered
                self._note(
                    tick, "its node answers a stamp twice" if again else "its node answers a stamp of no odometry"
                )
                continue
            if not all(map(isfinite, tau)):
                self._note(tick, "its node commands what is no number: the wrench before holds")
            else:
                self._tau = tau
            if self._waits:
                self._answered = at
                return

    def _answer(self, message: Any) -> None:
        """On a thread of zenoh."""
        wrench, stamp = message.wrench, message.header.stamp
        _, pitch, yaw = frd((0.0, wrench.torque.y, wrench.torque.z))
        self._answers.put(((stamp.sec, stamp.nanosec), (wrench.force.x, pitch, yaw)))

    def _note(self, tick: int, text: str) -> None:
        """Once each, in the log of the run and here."""
        if text not in self._noted:
            self._noted.add(text)
            self._notes.append((tick, text))
            self._tell(f"warning: {text}")

    def _tell_problems(self) -> None:
        while self._node.problems:
            self._tell(f"warning: {self._node.problems.popleft()}")

    def take_notes(self) -> list[tuple[int, str]]:
        """(tick, text) of what a person should know since the last call."""
        taken, self._notes = self._notes, []
        return taken
