"""The bus within a vehicle: navs down and commands up, over a pair of Unix sockets (SOCK_SEQPACKET) for each agent.

The sensors and actuators of a vehicle are not the network that a run is about, and zenoh takes six wake-ups for a round
trip where a socket takes one. The messages are those of the wire protocol, byte for byte. The console makes a pair for
each agent that it starts. The agent inherits one end, the world gets the other one, and no other process has either, so
the bus needs no password. Agents that somebody else starts, agents that share a process, and runs on a wall clock have
the keys `nav` and `cmd` of zenoh in place of it.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from queue import Queue
from threading import Thread

from netem.errors import BusError
from netem.limits import WIRE_MESSAGE
from netem.wire.queues import PutQueue

_NUMBER_BYTES = 20  # length of an agent's number, before the end that the console hands over


class Ends:
    """The console's side: it makes the pairs, and hands the world its ends."""

    def __init__(self) -> None:
        self._world, self.of_world = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def new(self, i: int) -> socket.socket:
        """The end of an agent i that is about to start. The world gets the other end, in place of one before. Raises
        OSError: the world has ended, or too many files are open.
        """
        theirs, worlds = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with worlds:
            try:
                socket.send_fds(self._world, [b"%d" % i], [worlds.fileno()])
            except OSError:
                theirs.close()
                raise
        return theirs

    def close(self) -> None:
        self._world.close()
        self.of_world.close()


class AgentEnd:
    """The end of an agent."""

    def __init__(self, end: socket.socket, key: str) -> None:
        """`key`: that of what comes in, as zenoh would name it."""
        self._end, self._key = end, key

    def put(self, data: bytes) -> None:
        """Send a message. Raises BusError: it is too long, or the world has ended."""
        _send(self._end, data)

    def get(self) -> tuple[str, bytes]:
        """The next (key, bytes); waits for it. Raises BusError: the world has ended."""
        return self._key, self._received(0)

    def poll(self) -> tuple[str, bytes] | None:
        """The next (key, bytes), or None when there is none yet. Raises BusError: the world has ended."""
        try:
            return self._key, self._received(socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None

    def _received(self, flags: int) -> bytes:
        try:
            data = self._end.recv(WIRE_MESSAGE.bytes, flags)
        except ConnectionError:
            data = b""
        if not data:
            raise BusError("the world has closed the bus of this vehicle")
        return data


class Inbound:
    """The world's side: it takes the puts of a channel of zenoh and the messages of agents in one order."""

    def __init__(self, channel: PutQueue, capacity: int, control: socket.socket, key: Callable[[int], str]) -> None:
        """`capacity`: puts that wait here, besides those in the channel. `control`: where the console hands over the
        ends of agents. `key`: that of what comes from an agent, as zenoh would name it.
        """
        self._epoll = select.epoll()
        self._ready: deque[tuple[str, bytes]] = deque()
        self._puts: Queue[tuple[str, bytes]] = Queue(capacity)
        self._arrived = os.eventfd(0)
        self._ends: dict[int, tuple[int, str, socket.socket]] = {}  # agents by the descriptor of their end
        self._of: dict[int, socket.socket] = {}  # ends by agent
        self._control, self._key = control, key
        self._epoll.register(self._arrived, select.EPOLLIN)
        self._epoll.register(control, select.EPOLLIN)
        Thread(target=self._pump, args=(channel,), name="inbound", daemon=True).start()

    def put(self, i: int, data: bytes) -> bool:
        """Send a message to agent i. False: it has no end here. If the agent has ended, the message is lost, as a put
        on a key without a subscriber. Raises BusError: it is too long.
        """
        end = self._of.get(i)
        if end is None:
            return False
        with suppress(_Ended):
            _send(end, data)
        return True

    def get(self) -> tuple[str, bytes]:
        """The next (key, bytes); waits for it."""
        while not self._ready:
            self._gather(-1.0)
        return self._ready.popleft()

    def poll(self) -> tuple[str, bytes] | None:
        """The next (key, bytes), or None when there is none yet."""
        if not self._ready:
            self._gather(0.0)
        return self._ready.popleft() if self._ready else None

    def _gather(self, timeout_s: float) -> None:
        ready, ends = self._ready, self._ends
        for descriptor, _ in self._epoll.poll(timeout_s):
            if (known := ends.get(descriptor)) is not None:
                i, key, end = known
                try:
                    data = end.recv(WIRE_MESSAGE.bytes, socket.MSG_DONTWAIT)
                except BlockingIOError:
                    continue
                except OSError:
                    data = b""
                if data:
                    ready.append((key, data))
                else:
                    self._drop(i, end)
            elif descriptor == self._arrived:
                for _ in range(os.eventfd_read(descriptor)):
                    ready.append(self._puts.get())
            elif descriptor == self._control.fileno():
                self._take_ends()
            # Any other descriptor is an end that a new one has replaced since this batch of events was read.

    def _take_ends(self) -> None:
        number, descriptors, _, _ = socket.recv_fds(self._control, _NUMBER_BYTES, 1)
        if not number:
            self._epoll.unregister(self._control)  # the console has ended
        for descriptor in descriptors:
            i, end = int(number), socket.socket(fileno=descriptor)
            if (before := self._of.get(i)) is not None:
                self._drop(i, before)
            self._of[i], self._ends[descriptor] = end, (i, self._key(i), end)
            self._epoll.register(end, select.EPOLLIN)

    def _drop(self, i: int, end: socket.socket) -> None:
        self._epoll.unregister(end)
        del self._of[i], self._ends[end.fileno()]
        end.close()

    def _pump(self, channel: PutQueue) -> None:
        while True:
            self._puts.put(channel.get())
            os.eventfd_write(self._arrived, 1)


class _Ended(BusError):
    """The other end is closed."""


def _send(end: socket.socket, data: bytes) -> None:
    if len(data) > WIRE_MESSAGE.bytes:
        raise BusError(f"a message of {len(data)} bytes on the bus of a vehicle: it carries {WIRE_MESSAGE.bytes}")
    try:
        end.send(data)
    except OSError as error:  # another thread may just have closed it
        if error.errno == errno.EMSGSIZE:
            raise BusError(
                f"a message of {len(data)} bytes is longer than the buffer of the bus of a vehicle: raise "
                "net.core.wmem_max"
            ) from None
        raise _Ended("the other end of the bus of a vehicle is closed") from None
