"""Queries that wait for answers of several robots: when they end, and how many may wait."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from netem.limits import QUERIES_WAITING


@dataclass(slots=True, eq=False)
class Ticket:
    """A query of a robot's program that waits for its answers."""

    query: Any  # zenoh's own; None: it has ended
    asker: int
    sent: dict[int, int] = field(default_factory=dict)  # replies by robot that went into a link
    arrived: dict[int, int] = field(default_factory=dict)
    ended: set[int] = field(default_factory=set)  # robots of which no reply will come any more

    def end(self) -> None:
        """Tell who asked that there will be no more answers."""
        if self.query is not None:
            self.query.drop()
            self.query = None  # the query also holds its payload


class OpenQueries:
    """The queries that have not ended. A query ends when all answers of all that hear its asker have arrived.

    If an answer was lost on its way, the query does not end: who asked waits for its own time-out, as in any network.
    """

    def __init__(self, hearers: Mapping[int, set[int]], end: Callable[[Ticket], None]) -> None:
        """Have none yet.

        Args:
            hearers: by robot, those that get its queries.
            end: tells who asked; it has to come behind the answers.
        """
        self._hearers, self._end = hearers, end
        self._waiting: dict[Ticket, int] = {}  # oldest first, with the bytes of its query; without us it would end
        self._bytes = 0

    def begin(self, ticket: Ticket, size: int) -> None:
        """A query of `size` bytes goes out. The oldest ones end, if too many wait: who asked has given up long ago."""
        self._waiting[ticket] = size
        self._bytes += size
        while len(self._waiting) > QUERIES_WAITING.items or self._bytes > QUERIES_WAITING.bytes:
            self._drop(next(iter(self._waiting)))

    def add_replies(self, ticket: Ticket, robot: int, count: int = 1) -> None:
        """So many more replies of a robot are on their way."""
        ticket.sent[robot] = ticket.sent.get(robot, 0) + count

    def on_reply(self, ticket: Ticket, robot: int) -> None:
        """A reply of a robot has arrived."""
        ticket.arrived[robot] = ticket.arrived.get(robot, 0) + 1
        self._finish(ticket)

    def on_robot_ended(self, ticket: Ticket, robot: int) -> None:
        """A robot will send no more replies."""
        ticket.ended.add(robot)
        self._finish(ticket)

    def _finish(self, ticket: Ticket) -> None:
        complete = all(ticket.arrived.get(i, 0) >= n for i, n in ticket.sent.items())
        if complete and ticket.ended >= self._hearers.get(ticket.asker, set()):
            self._drop(ticket)

    def _drop(self, ticket: Ticket) -> None:
        self._bytes -= self._waiting.pop(ticket, 0)
        self._end(ticket)
