"""Ports of the own host that stand for programs of other agents, as a file of nodes names them.

A datagram that a program sends to such a port of 127.0.0.1 is one for a port of another agent. There it seems to come
from the port that leads back, if there is one, so that an answer to the sender comes to us.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

LOOPBACK = "127.0.0.1"


class UdpWays:
    """The ways of one agent."""

    def __init__(self, given: Mapping[Any, Any]) -> None:
        """Read them.

        Args:
            given: by port of the own host: the other agent, and the port of its program; 0: that from which its own
                datagrams came last.

        Raises:
            ValueError: they are of another form.
        """
        self._ways: dict[int, tuple[int, int]] = {}
        for port, (agent, to) in given.items():
            self._ways[int(port)] = int(agent), int(to)
        self._back = {agent: port for port, (agent, _) in self._ways.items()}
        self._last: dict[int, int] = {}  # by agent: the port of the own program that sent to it last

    def __bool__(self) -> bool:
        return bool(self._ways)

    def way(self, port: int) -> tuple[int, int] | None:
        """The agent and the port that a port of the own host stands for."""
        return self._ways.get(port)

    def sends(self, agent: int, from_port: int) -> None:
        """A program of the own has sent something to an agent."""
        self._last[agent] = from_port

    def arrives(self, src: int, to_port: int) -> tuple[int, int] | None:
        """Where a datagram of an agent goes, and from which port of the own host it seems to come; None: nowhere.

        Args:
            src: the agent that has sent it.
            to_port: for which it is; 0: for the program that sent to this agent last.
        """
        target = to_port or self._last.get(src, 0)
        return (target, self._back.get(src, 0)) if target else None
