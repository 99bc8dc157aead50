"""Datagrams of programs: what stands in for UDP sockets. The address of an agent ends with its number."""

from __future__ import annotations

import re
import socket as real_socket
from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from types import ModuleType
from typing import Any, ClassVar

from fleet.addons.programs.standard import NO_SOCKETS, Function, stand_in
from fleet.addons.programs.turns import Turns, Waiters

EVERYBODY = 0
MOST_WAITING = 4096  # datagrams that a socket holds; more are lost, as in a kernel
MOST_BYTES = 65_507
_FIRST_FREE = 49_152  # port that a socket gets that has asked for none
_FIRST_FILE = 1 << 20  # number of the first socket as a file: none that the process has
Address = tuple[str, int]


class AddressBook:
    """The agents behind addresses."""

    def __init__(self, own: int, given: Mapping[str, int]) -> None:
        """Take the addresses that the scenario names: `HOST:PORT` or `HOST`, and the agent's number.

        Args:
            own: number of this agent.
            given: agents by address.
        """
        self.own = own
        self._given = dict(given)
        self._named = {number: key for key, number in given.items()}

    def agent(self, host: str, port: int) -> int:
        """The agent at an address; `EVERYBODY`: all of them. Raises OSError: nobody is there."""
        for key in (f"{host}:{port}", host):
            if key in self._given:
                return self._given[key]
        if host in ("127.0.0.1", "localhost", "0.0.0.0", "", "::1"):
            return self.own
        parts = host.split(".")
        if len(parts) == 4 and all(part.isdecimal() for part in parts):
            first, last = int(parts[0]), int(parts[3])
            return EVERYBODY if last == 255 or 224 <= first < 240 or host == "<broadcast>" else last
        if number := re.search(r"(\d+)$", host):
            return int(number[1])
        if host == "<broadcast>":
            return EVERYBODY
        raise real_socket.gaierror(
            real_socket.EAI_NONAME, f"no agent is at {host!r}: use 10.0.0.NUMBER, or `addresses` of the program"
        )

    def shown(self, agent: int, port: int) -> Address:
        """The address of an agent as a program sees it."""
        key = self._named.get(agent, f"10.0.0.{agent}")
        return key.partition(":")[0], port


class Datagrams:
    """The sockets of one program."""

    def __init__(self, turns: Turns, book: AddressBook, send: Callable[[int, int, int, bytes], None]) -> None:
        """Have none yet.

        Args:
            turns: the program's threads.
            book: addresses of agents.
            send: takes a datagram: to which agent, from which port, to which port, and its bytes.
        """
        self.turns, self.book, self._send = turns, book, send
        self._bound: dict[int, Callable[[bytes, Address], None]] = {}
        self.files: dict[int, deque[tuple[bytes, Address]]] = {}  # what has come to sockets, by their numbers
        self.numbers = count(_FIRST_FILE)
        self.selecting = Waiters(turns)  # threads that wait for any of several sockets

    def bind(self, port: int, hear: Callable[[bytes, Address], None]) -> int:
        """Hear what comes to a port; 0: any free one. Returns the port. Raises OSError: it is taken."""
        if not port:
            port = next(p for p in range(_FIRST_FREE, 65_536) if p not in self._bound)
        if port in self._bound:
            raise OSError(98, f"Address already in use: port {port}")
        self._bound[port] = hear
        return port

    def close(self, port: int) -> None:
        """Hear nothing more at a port."""
        self._bound.pop(port, None)

    def send(self, data: bytes, port: int, to: Address) -> None:
        """Send a datagram from a port. Raises OSError: it is too long, or nobody is there."""
        if len(data) > MOST_BYTES:
            raise OSError(90, "Message too long")
        agent = self.book.agent(*to[:2])
        if agent in (self.book.own, EVERYBODY):
            self.hear(self.book.own, port, to[1], data)
        if agent != self.book.own:
            self._send(agent, port, to[1], data)

    def hear(self, src: int, src_port: int, port: int, data: bytes) -> None:
        """A datagram has come."""
        if hear := self._bound.get(port):
            hear(data, self.book.shown(src, src_port))


class Socket:
    """A UDP socket; each program has the class for itself."""

    _of_program: ClassVar[Datagrams]
    _default_timeout: ClassVar[float | None] = None

    @classmethod
    def setdefaulttimeout(cls, timeout: float | None) -> None:
        cls._default_timeout = timeout

    @classmethod
    def getdefaulttimeout(cls) -> float | None:
        return cls._default_timeout

    def __init__(self, family: int = -1, type: int = -1, proto: int = 0, fileno: Any = None) -> None:
        kind = real_socket.SOCK_STREAM if type == -1 else type
        if kind & 0xF != real_socket.SOCK_DGRAM or fileno is not None:
            raise OSError(NO_SOCKETS)
        self.family, self.type, self.proto = real_socket.AF_INET, real_socket.SOCK_DGRAM, proto
        self._port, self._timeout = 0, self._default_timeout
        self._peer: Address | None = None
        self._got: deque[tuple[bytes, Address]] = deque()
        self._waiting = Waiters(self._of_program.turns)
        self._closed, self._file = False, next(self._of_program.numbers)
        self._of_program.files[self._file] = self._got

    def bind(self, address: Address) -> None:
        self._port = self._of_program.bind(address[1], self._hear)

    def _hear(self, data: bytes, source: Address) -> None:
        if (self._peer is None or source[1] == self._peer[1]) and len(self._got) < MOST_WAITING:
            self._got.append((data, source))
            self._waiting.wake(1)
            self._of_program.selecting.wake()

    def _bound(self) -> int:
        if not self._port:
            self._port = self._of_program.bind(0, self._hear)
        return self._port

    def connect(self, address: Address) -> None:
        self._of_program.book.agent(*address[:2])
        self._peer = address

    def sendto(self, data: Any, *more: Any) -> int:
        self._of_program.send(bytes(data), self._bound(), more[-1])
        return len(data)

    def send(self, data: Any, flags: int = 0) -> int:
        if self._peer is None:
            raise OSError(89, "Destination address required")
        return self.sendto(data, self._peer)

    sendall = send

    def recvfrom(self, size: int, flags: int = 0) -> tuple[bytes, Address]:
        self._bound()
        if not self._got:
            if self._timeout == 0.0:
                raise BlockingIOError(11, "Resource temporarily unavailable")
            if not self._waiting.wait_s(self._timeout) or not self._got:
                if self._closed:
                    raise OSError(9, "Bad file descriptor")
                raise TimeoutError("timed out")
        data, source = self._got.popleft()
        return data[:size], source

    def recv(self, size: int, flags: int = 0) -> bytes:
        return self.recvfrom(size)[0]

    def settimeout(self, timeout: float | None) -> None:
        self._timeout = timeout

    def gettimeout(self) -> float | None:
        return self._timeout

    def setblocking(self, flag: bool) -> None:
        self._timeout = None if flag else 0.0

    def getsockname(self) -> Address:
        return self._of_program.book.shown(self._of_program.book.own, self._port)

    def getpeername(self) -> Address:
        if self._peer is None:
            raise OSError(107, "Transport endpoint is not connected")
        return self._peer

    def setsockopt(self, *_: Any) -> None: ...

    def getsockopt(self, *_: Any) -> int:
        return 0

    def fileno(self) -> int:
        return -1 if self._closed else self._file

    def close(self) -> None:
        self._closed = True
        self._of_program.close(self._port)
        self._of_program.files.pop(self._file, None)
        self._waiting.wake()

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def socket_module(datagrams: Datagrams) -> ModuleType:
    """The module `socket`: datagrams between agents, and nothing else."""
    book = datagrams.book
    own: Any = type("socket", (Socket,), {"_of_program": datagrams})

    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(NO_SOCKETS)

    streams = ("create_connection", "create_server", "socketpair", "fromfd", "getaddrinfo")
    return stand_in(
        real_socket, **dict.fromkeys(streams, refuse), socket=own, SocketType=own,
        gethostname=lambda: f"agent{book.own}", getfqdn=lambda name="": name,
        gethostbyname=lambda host: book.shown(book.agent(host, 0), 0)[0],
        setdefaulttimeout=own.setdefaulttimeout, getdefaulttimeout=own.getdefaulttimeout,
    )  # fmt: skip


def select_module(datagrams: Datagrams) -> ModuleType:
    """The module `select`, for sockets of `socket_module`. Python's `selectors` makes do with its `select`."""

    def readable(each: Any) -> bool:
        number = each if isinstance(each, int) else each.fileno()
        if number not in datagrams.files:
            raise OSError(9, "Bad file descriptor: only sockets of UDP can be waited for in lockstep")
        return bool(datagrams.files[number])

    def select(rlist: Any, wlist: Any, xlist: Any, timeout: float | None = None) -> tuple[list[Any], ...]:
        until, read, write = datagrams.turns.until(timeout), [*rlist], [*wlist]  # they can always be written to
        while not (found := [each for each in read if readable(each)]) and not write:
            if timeout == 0 or not datagrams.selecting.wait(until):
                break
        return found, write, []

    return stand_in(ModuleType("select"), select=Function(select), error=OSError)
