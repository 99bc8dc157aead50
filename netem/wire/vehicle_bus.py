"""The bus within a vehicle: navs down and commands up, over a pair of Unix sockets (SOCK_SEQPACKET) for each process.

The sensors and actuators of a vehicle are not the network that a run is about, and zenoh takes six wake-ups for a round
trip where a socket takes one. The messages are those of the wire protocol, byte for byte. The console makes a pair for
each process of agents that it starts. The process inherits one end, the world gets the other one, and nobody else has
either, so the bus needs no password. Agents that somebody else starts, agents on other hosts, and runs on a wall clock
have the keys `nav` and `cmd` of zenoh in place of it.
"""

from __future__ import annotations

import os
import select
import socket
from collections import deque
from contextlib import suppress
from queue import Queue
from threading import Thread

from netem.errors import BusError
from netem.wire.queues import PutQueue
from netem.wire.session import MAX_BYTES

_NAME_BYTES = 64  # of the process whose end the console hands over


class Ends:
    """The console's side: it makes the pairs, and hands the world its ends."""

    def __init__(self) -> None:
        self._world, self.of_world = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def new(self, name: str) -> socket.socket:
        """The end of a process that is about to start. `name`: the last part of its keys, `3` or `host-1`. The world
        gets the other end, in place of an earlier one with this name. Raises OSError: the world has ended, or too many
        files are open.
        """
        theirs, worlds = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with worlds:
            try:
                socket.send_fds(self._world, [name.encode()], [worlds.fileno()])
            except OSError:
                theirs.close()
                raise
        return theirs

    def close(self) -> None:
        self._world.close()
        self.of_world.close()


class AgentEnd:
    """The end of a process with agents."""

    def __init__(self, end: socket.socket, key: str) -> None:
        """`key`: that of what comes in, as zenoh would name it."""
        self._end, self._key = end, key

    def fileno(self) -> int:
        return self._end.fileno()

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
            data = self._end.recv(MAX_BYTES, flags)
        except ConnectionError:
            data = b""
        if not data:
            raise BusError("the world has closed the bus of this vehicle")
        return data


class Inbound:
    """What comes in to a process: the puts of a channel of zenoh, and the messages of sockets."""

    def __init__(self, channel: PutQueue, capacity: int, control: socket.socket | None = None, key: str = "") -> None:
        """`capacity`: puts that wait here, besides those in the channel. `control`: of the world, where the console
        hands over its ends; what comes from them counts as puts on `key` and the name of the process.
        """
        self._epoll = select.epoll()
        self._ready: deque[tuple[str, bytes]] = deque()
        self._puts: Queue[tuple[str, bytes]] = Queue(capacity)
        self._arrived = os.eventfd(0)
        self._epoll.register(self._arrived, select.EPOLLIN)
        self._ends: dict[int, tuple[str, socket.socket]] = {}  # by descriptor
        self._by_key: dict[str, socket.socket] = {}
        self._control, self._prefix = control, key
        if control is not None:
            self._epoll.register(control, select.EPOLLIN)
        Thread(target=self._pump, args=(channel,), name="inbound", daemon=True).start()

    def add(self, key: str, end: socket.socket) -> None:
        """Take what comes on `end`, as puts on `key`."""
        if (before := self._by_key.pop(key, None)) is not None:
            self._drop(before.fileno())
        self._by_key[key] = end
        self._ends[end.fileno()] = key, end
        self._epoll.register(end, select.EPOLLIN)

    def put(self, key: str, data: bytes) -> bool:
        """Send a message to the end whose messages come in on `key`. False: there is none. To one that has ended, it is
        lost, as a put on a key that nobody subscribes to. Raises BusError: it is too long.
        """
        end = self._by_key.get(key)
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
                key, end = known
                try:
                    data = end.recv(MAX_BYTES, socket.MSG_DONTWAIT)
                except OSError:
                    data = b""
                if data:
                    ready.append((key, data))
                else:
                    self._drop(descriptor)
            elif descriptor == self._arrived:
                for _ in range(os.eventfd_read(descriptor)):
                    ready.append(self._puts.get())
            elif self._control is not None:
                self._take_ends(self._control)

    def _take_ends(self, control: socket.socket) -> None:
        name, descriptors, _, _ = socket.recv_fds(control, _NAME_BYTES, 1)
        if not name:
            self._epoll.unregister(control)  # the console has ended
        for descriptor in descriptors:
            self.add(self._prefix + name.decode(), socket.socket(fileno=descriptor))

    def _drop(self, descriptor: int) -> None:
        key, end = self._ends.pop(descriptor)
        self._epoll.unregister(descriptor)
        if self._by_key.get(key) is end:
            del self._by_key[key]
        end.close()

    def _pump(self, channel: PutQueue) -> None:
        while True:
            self._puts.put(channel.get())
            os.eventfd_write(self._arrived, 1)


class _Ended(BusError):
    """The other end is closed."""


def _send(end: socket.socket, data: bytes) -> None:
    if len(data) > MAX_BYTES:
        raise BusError(f"a message of {len(data)} bytes on the bus of a vehicle: it carries {MAX_BYTES}")
    try:
        end.send(data)
    except OSError:  # also of one that another thread has just closed
        raise _Ended("the other end of the bus of a vehicle is closed") from None
