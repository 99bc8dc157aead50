"""Sockets that several processes of a program have, after a fork: who has which, and who writes what arrives."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from fleet.addons.programs.processes import Process

SHARED, TAKEN, RELEASED, REST = 98, 97, 107, 120  # b, a, k, x: what the library tells
KINDS = (SHARED, TAKEN, RELEASED, REST)
_WRITE, _FREE, _TAKEN, _DATA = 119, 102, 104, 82  # w, f, h, R: what it is told
_ID = struct.Struct("<QQ")
_PART = 1 << 15
Send = Callable[[int, int, bytes], None]  # to a process: its number, kind, bytes


@dataclass
class _Shared:
    connection: int  # of a stream; 0: it is none, or has none yet
    writer: int
    holders: set[int]
    unread: bool = False
    rest: bytearray = field(default_factory=bytearray)  # what a writer that has ended did not put into the pair


class SharedSockets:
    """Those of one program, by the number that the library has given them."""

    def __init__(
        self, send: Send, close: Callable[[int, bool], None], change_owner: Callable[[int, int], None]
    ) -> None:
        """Have none yet.

        Args:
            send: sends a message to a process.
            close: closes a stream that nobody has any more: the connection, and whether bytes were not read.
            change_owner: names another process as the one whose end closes a stream.
        """
        self._send, self._close, self._change_owner = send, close, change_owner
        self._sockets: dict[int, _Shared] = {}

    def on_message(self, process: int, kind: int, data: bytes) -> None:
        """Take a message of one of `KINDS` of a process."""
        if kind == SHARED:
            child = int.from_bytes(data[:4], "little")
            for number, connection in _ID.iter_unpack(data[4:]):
                shared = self._sockets.setdefault(number, _Shared(connection, process, {process}))
                shared.connection = connection or shared.connection
                shared.holders.add(child)
            return
        number, connection = _ID.unpack_from(data)
        if kind == TAKEN:
            writer = number >> 16
            self._sockets[number] = _Shared(connection, writer, {process})
            self._send(writer, _TAKEN, data[:8])
        elif number in self._sockets:
            shared = self._sockets[number]
            shared.connection = connection or shared.connection
            if kind == REST:
                shared.rest += data[_ID.size :]
                return
            shared.unread |= bool(data[_ID.size])
            shared.holders.discard(process)
            self._free_if_nobody_has(number, shared)

    def on_process_ended(self, process: Process) -> None:
        """A process has ended, or executes something else: it has no sockets any more."""
        for number, shared in list(self._sockets.items()):
            shared.holders.discard(process.pid)
            if shared.writer == process.pid:
                shared.rest += _pending(process, shared.connection)
                if shared.holders:
                    self._hand_over(number, shared)
            self._free_if_nobody_has(number, shared)

    def is_held(self, connection: int) -> bool:
        """Whether a process still has a stream that several had."""
        return any(each.connection == connection for each in self._sockets.values())

    def _hand_over(self, number: int, shared: _Shared) -> None:
        shared.writer = min(shared.holders)
        self._send(shared.writer, _WRITE, number.to_bytes(8, "little"))
        if shared.connection:
            self._change_owner(shared.connection, shared.writer)
            head = shared.connection.to_bytes(8, "little")
            for at in range(0, len(shared.rest), _PART):
                self._send(shared.writer, _DATA, head + shared.rest[at : at + _PART])
        shared.rest.clear()

    def _free_if_nobody_has(self, number: int, shared: _Shared) -> None:
        if shared.holders:
            return
        del self._sockets[number]
        if shared.connection:
            self._close(shared.connection, shared.unread)
        self._send(shared.writer, _FREE, number.to_bytes(8, "little"))


def _pending(process: Process, connection: int) -> bytes:
    """What came on a stream and waits for the next turn of a process, which does not come."""
    found, inbox, at = bytearray(), process.inbox, 0
    while connection and at < len(inbox):
        length = int.from_bytes(inbox[at : at + 4], "little")
        if inbox[at + 4] == _DATA and int.from_bytes(inbox[at + 5 : at + 13], "little") == connection:
            found += inbox[at + 13 : at + 4 + length]
        at += 4 + length
    return bytes(found)
