"""A port of UDP for a law: it hears the programs of other agents, and they hear it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple
from zlib import crc32

from agents.config import AgentConfig
from agents.packets import EVERYBODY, V4, Datagram, DatagramAssembly, node_address, read
from netem.wire.messages import Delivery

MOST_DATA = 65_507  # bytes; UDP over IPv4 carries no more
_BROADCAST = V4 + b"\x0a\0\xff\xff"  # 10.0.255.255


class Received(NamedTuple):
    """A datagram that has come: `src` is the number of the agent that has sent it, and `port` the port of it."""

    src: int
    port: int
    data: bytes


class UdpPort:
    """A port of the agent's node. Payloads are packets as programs send them, with the headers of IP and UDP.

    A program of another agent sends to this law's address, 10.0.0.NUMBER, and to this port, or to everybody.
    """

    def __init__(self, config: AgentConfig, port: int) -> None:
        """Open the port.

        Args:
            config: the agent's slice of the scenario.
            port: its number, 1 to 65535.

        Raises:
            ValueError: there is no such port.
        """
        if not 0 < port < 65_536:
            raise ValueError(f"expected a port of 1 to 65535, got {port}")
        self._own, self._port, self._sent = config.id, port, 0
        self._fragments = DatagramAssembly()

    def send(self, data: bytes, to: int = EVERYBODY, port: int | None = None) -> list[bytes]:
        """Make the payloads of a datagram, which `transmit` returns. What is longer than 1,472 bytes has several.

        Args:
            data: at most 65,507 bytes.
            to: the number of an agent that hears this one; 0: all that do.
            port: on which its program listens; None: the number of this port.

        Returns:
            The payloads.

        Raises:
            ValueError: the data are too long, or there is no such agent or port.
        """
        target = self._port if port is None else port
        if len(data) > MOST_DATA or not 0 < target < 65_536:
            raise ValueError(
                f"expected at most {MOST_DATA} bytes and a port of 1 to 65535, got {len(data)} and {target}"
            )
        if not EVERYBODY <= to < 65_536:
            raise ValueError(f"expected the number of an agent, or 0 for all, got {to}")
        self._sent += 1
        # A law that is killed counts from 1 again, and fragments of its former life may still wait for the rest.
        number = crc32(data, self._sent) & 0xFFFF
        ip = _BROADCAST if to == EVERYBODY else node_address(to, False)
        return [each.packed() for each in Datagram(to, self._port, target, ip, data).fragments(number)]

    def receive(self, deliveries: Iterable[Delivery]) -> Iterator[Received]:
        """Read what has come for this port. Other payloads, and damaged ones, are left out.

        Args:
            deliveries: those of `decide`, each of them once.

        Returns:
            The datagrams that are whole now, in their order.
        """
        for delivery in deliveries:
            packet = read(delivery.payload)
            if not isinstance(packet, Datagram) or packet.to_port != self._port:
                continue
            if packet.agent in (EVERYBODY, self._own) and (whole := self._fragments.whole(delivery.src, packet)):
                yield Received(delivery.src, whole.from_port, whole.data)
