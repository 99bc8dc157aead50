"""Robots whose programs are in network namespaces of their own: each packet of IP that they send is one of ours."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from threading import Thread
from time import monotonic_ns
from typing import NamedTuple

from netem import namespaces
from netem.condition import Link
from netem.robot_message import PACKET, RobotMessage
from netem.wire.robot_queues import Inlet
from netem.wire.robots import Unfit

_LONGEST = 1 << 16


class IpPacket(NamedTuple):
    """A packet that has come from programs of a robot."""

    robot: int
    at_ns: int
    payload: bytes
    whereto: namespaces.Whereto


class IsolatedRobots:
    """Their namespaces, and the way of packets out of and into them."""

    def __init__(self, numbers: Iterable[int], names: Mapping[int, str], links: Iterable[Link]) -> None:
        """Make the namespaces. This process may have no second thread yet. Raises BusError: the system gives none.

        Args:
            numbers: of the robots.
            names: of all robots, by number.
            links: of the network.
        """
        self._names, self._links = names, frozenset(links)
        self._all: dict[int, namespaces.Namespace] = {}
        for number in numbers:
            self._all[number] = namespaces.make_namespace(number)

    @property
    def files(self) -> dict[int, tuple[str, ...]]:
        """The files that programs of each robot enter."""
        return {i: tuple(f"/proc/{os.getpid()}/fd/{file}" for file in one.enter) for i, one in self._all.items()}

    def listen(self, inlets: Mapping[int, Inlet]) -> None:
        """Let what comes from each robot go into its inlet, as an `IpPacket`."""
        for number, one in self._all.items():
            Thread(target=self._read, args=(number, one.packets, inlets[number]), daemon=True).start()

    def _read(self, robot: int, packets: int, inlet: Inlet) -> None:
        with suppress(OSError):  # closed at the end
            while True:
                payload = os.read(packets, _LONGEST)
                if (whereto := namespaces.read(payload)) is not None:
                    name = partial(Unfit, PACKET, whereto.key, len(payload), whereto.to or None)
                    inlet.offer(IpPacket(robot, monotonic_ns(), payload, whereto), len(payload), name)

    def message(self, packet: IpPacket) -> RobotMessage | str:
        """A packet as a message for the links, or in words why none takes it."""
        robot, at_ns, payload, (to, key, where) = packet
        if to is None or (to and to not in self._names):
            return f"{self._names[robot]} sends to {where}, which is none of the nodes"
        if to and (robot, to) not in self._links:
            return f"{self._names[robot]} sends to {self._names[to]}, and no link leads there"
        return RobotMessage(robot, PACKET, key, payload, at_ns, None, to or None)

    def hand(self, robot: int, payload: bytes) -> bool:
        """Give a packet to the programs of a robot. False: the kernel refuses it, as one with a damaged header."""
        with suppress(OSError):
            return os.write(self._all[robot].packets, payload) > 0
        return False

    def close(self) -> None:
        """Let the namespaces go; programs keep theirs."""
        for one in self._all.values():
            one.close()
