"""Streams of programs (TCP) over links that lose: segments, acknowledgements, and repetition.

The model is TCP without congestion control: segments of at most 1,460 bytes (1,440 of IPv6), a window of 64 KiB, each
segment acknowledged, what comes out of order is kept. The first segment that is not acknowledged is sent again after a
time-out by RFC 6298 (1 s at first, at least 0.2 s as in Linux), which doubles each time; three acknowledgements of the
same byte send it again at once (RFC 5681). A connection that is not answered six times has timed out, as in Linux.
(Rejected: to let the network decide of a stream as a whole, with a delay for each loss. It is shorter, but then losses
cost no capacity, and acknowledgements cross no link.)
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from agents.packets import V4, Segment, node_address

SYN, SYN_ACK, DATA, FIN, RST = 1, 2, 3, 4, 5
WINDOW = 1 << 16
FIRST_RTO_NS, LEAST_RTO_NS, MOST_RTO_NS = 10**9, 2 * 10**8, 60 * 10**9
SYN_TRIES, TRIES = 6, 15
_CALL = struct.Struct("<Q16sH16sH")
Deliver = Callable[[int, bytes, int], None]  # to a process: kind, bytes, its number; 0: to all


@dataclass
class StreamEnd:
    """One end of a connection."""

    owner: int  # number of the process that has it
    connection: int  # as the program's library knows it; the other end has the same number with its last bit changed
    agent: int  # of the other end; the own one for the loopback
    from_port: int
    to_port: int
    v6: bool
    stands: bool = False
    unsent: bytearray = field(default_factory=bytearray)  # from the first byte that is not acknowledged
    first: int = 0  # its number
    next: int = 0  # the next byte to send
    window: int = WINDOW
    ends_at: int | None = None  # FIN comes behind this byte; it counts as one
    expected: int = 0
    kept: dict[int, bytes] = field(default_factory=dict)
    end_at: int | None = None  # where the other end's bytes end
    waiting: int = 0  # bytes that the program has not read
    owed: int = 0  # bytes of the loopback that are not acknowledged yet
    closed: bool = False  # the program knows it no more
    rto_ns: int = FIRST_RTO_NS
    smooth_ns: int = 0
    deviation_ns: int = 0
    due_ns: int | None = None
    tries: int = 0
    same: int = 0  # acknowledgements of the same byte
    recover: int = 0  # until this byte is acknowledged, each acknowledgement sends the next hole
    timed: tuple[int, int] | None = None  # a byte, and when it was sent for the first time


class Streams:
    """The connections of one agent."""

    def __init__(
        self,
        agent: int,
        send: Callable[[Segment], None],
        deliver: Deliver,
        unanswered: Callable[[int], bool] = lambda port: False,
    ) -> None:
        """Have none yet.

        Args:
            agent: the own number.
            send: sends a segment to another agent.
            deliver: hands a message to one of the program's processes, or to all.
            unanswered: says of a port on which nobody of the program listens whether a call waits there, until
                `call_again`. Other calls are refused.
        """
        self._agent, self._send, self._deliver, self._unanswered = agent, send, deliver, unanswered
        self._waiting: dict[int, bytes] = {}  # calls of own processes that wait for somebody who listens
        self._ends: dict[int, StreamEnd] = {}
        self._calls: dict[int, int] = {}  # by connection that is asked for: processes that have not refused it yet
        self.now_ns = 0
        self.processes = 1  # how many the program has

    def on_message(
        self,
        process: int,
        kind: int,
        data: bytes,
        agent_of: Callable[[bytes, int], int | None],
        is_held: Callable[[int], bool] = lambda _: False,
    ) -> None:
        """Take a message of a process.

        Args:
            process: its number.
            kind: of the message; 0: the process has ended.
            data: its bytes.
            agent_of: the agent at an address and port; None: nobody.
            is_held: whether other processes have a connection, too.
        """
        if kind == 0:
            for own in [each for each in self._ends.values() if each.owner == process and not each.closed]:
                if not is_held(own.connection):
                    self._close(own, unread=False)
            return
        connection = int.from_bytes(data[:8], "little")
        if kind == 65:  # A: connect
            self._connect(process, data, agent_of)
            return
        if kind in (80, 88):  # P, X: a call was taken, or refused by one process
            self._answered(process, connection, kind == 80)
            return
        end = self._ends.get(connection)
        if end is None:
            return
        if kind == 87:  # W: write
            self._write(end, data[8:])
        elif kind == 70:  # F: no more is written
            self._finish(end)
        elif kind == 86:  # V: so many bytes are not read
            self._waits(end, int.from_bytes(data[8:12], "little"))
        elif kind == 75:  # K: closed
            self._close(end, unread=bool(data[8]))

    def close(self, connection: int, unread: bool) -> None:
        """Close a connection that no process has any more."""
        if end := self._ends.get(connection):
            self._close(end, unread)

    def change_owner(self, connection: int, process: int) -> None:
        """Another process's end closes a connection from now on."""
        if end := self._ends.get(connection):
            end.owner = process

    def _connect(self, process: int, data: bytes, agent_of: Callable[[bytes, int], int | None]) -> None:
        connection, _, from_port, to_ip, to_port = _CALL.unpack(data)
        agent = agent_of(to_ip, to_port)
        end = StreamEnd(process, connection, agent or 0, from_port, to_port, to_ip[:12] != V4)
        self._ends[connection] = end
        if agent is None:
            self._fail(end, errno.EHOSTUNREACH)
        elif agent == self._agent:
            self._call_own(end, data)
        else:
            end.tries, end.due_ns = 1, self.now_ns + end.rto_ns
            self._put(end, SYN)

    def _call_own(self, end: StreamEnd, call: bytes) -> None:
        other = end.connection | 1
        self._calls[other] = self.processes
        self._ends[other] = StreamEnd(0, other, self._agent, end.to_port, end.from_port, end.v6, stands=True)
        self._waiting[end.connection] = call
        self._deliver(65, other.to_bytes(8, "little") + call[8:], 0)

    def call_again(self) -> None:
        """Somebody listens now whom calls have waited for."""
        for connection, call in self._waiting.items():
            if connection | 1 not in self._calls and (end := self._ends.get(connection)):
                self._call_own(end, call)

    def _answered(self, process: int, connection: int, taken: bool) -> None:
        left = self._calls.get(connection)
        end = self._ends.get(connection)
        if left is None or end is None:
            return
        if not taken and left > 1:
            self._calls[connection] = left - 1
            return
        del self._calls[connection]
        local = end.agent == self._agent
        if taken:
            end.stands, end.owner = True, process
            if local:
                other = self._ends[connection ^ 1]
                other.stands = True
                self._waiting.pop(other.connection, None)
                self._tell(other, 79)
            else:
                self._put(end, SYN_ACK)
            return
        del self._ends[connection]
        if local:
            other = self._ends[connection ^ 1]
            if not self._unanswered(other.to_port):
                self._waiting.pop(other.connection, None)
                self._fail(other, errno.ECONNREFUSED)
        else:
            self._put(end, RST)

    def _tell(self, end: StreamEnd, kind: int, data: bytes = b"") -> None:
        self._deliver(kind, end.connection.to_bytes(8, "little") + data, end.owner)

    def _fail(self, end: StreamEnd, error: int) -> None:
        self._ends.pop(end.connection, None)
        if not end.closed:
            self._tell(end, 69, error.to_bytes(4, "little"))

    def _write(self, end: StreamEnd, data: bytes) -> None:
        if end.agent == self._agent:
            other = self._ends.get(end.connection ^ 1)
            if other is None or other.closed:
                self._fail(end, errno.EPIPE)
                return
            self._tell(other, 82, data)
            end.owed += len(data)
            if end.owed >= WINDOW and other.waiting <= 2 * WINDOW:  # not each time: an acknowledgement costs a turn
                self._acknowledge(end, end.owed)
                end.owed = 0
            return
        end.unsent += data
        self._pump(end)

    def _acknowledge(self, end: StreamEnd, size: int) -> None:
        if not end.closed:
            self._tell(end, 81, size.to_bytes(4, "little"))

    def _finish(self, end: StreamEnd) -> None:
        if end.ends_at is not None:
            return
        end.ends_at = end.first + len(end.unsent)
        if end.agent != self._agent:
            self._pump(end)
        elif other := self._ends.get(end.connection ^ 1):
            self._tell(other, 90)

    def _waits(self, end: StreamEnd, size: int) -> None:
        was, end.waiting = end.waiting, size
        if end.agent != self._agent:
            if was >= WINDOW // 2 > size:
                self._put(end, DATA)  # the window is open again
        elif (other := self._ends.get(end.connection ^ 1)) and other.owed and size <= 2 * WINDOW:
            self._acknowledge(other, other.owed)
            other.owed = 0

    def _close(self, end: StreamEnd, unread: bool) -> None:
        end.closed = True
        if end.agent == self._agent:
            other = self._ends.get(end.connection ^ 1)
            if other is not None and unread:
                self._fail(other, errno.ECONNRESET)
            else:
                self._finish(end)
            if other is None or other.closed or unread:
                self._ends.pop(end.connection, None)
                self._ends.pop(end.connection ^ 1, None)
        elif unread or not end.stands:
            self._put(end, RST)
            self._ends.pop(end.connection, None)
        else:
            self._finish(end)
            self._forget_if_done(end)

    def hear(self, src: int, segment: Segment) -> None:
        """Take a segment. `src`: the agent that has sent it."""
        connection = segment.connection
        end = self._ends.get(connection)
        if segment.kind == SYN:
            self._called(src, segment, end)
            return
        if end is None or end.agent != src:
            if segment.kind != RST and (segment.data or segment.kind != DATA):
                self._send(_reset(src, segment))
            return
        if segment.kind == RST:
            self._fail(end, errno.ECONNRESET if end.stands else errno.ECONNREFUSED)
        elif segment.kind == SYN_ACK:
            if not end.stands:
                end.stands, end.due_ns, end.tries = True, None, 0
                self._tell(end, 79)
            self._put(end, DATA)
        else:
            self._acknowledged(end, segment)
            if segment.data or segment.kind == FIN:
                self._arrived(end, segment)
            self._forget_if_done(end)

    def _called(self, src: int, segment: Segment, end: StreamEnd | None) -> None:
        if end is not None:
            if end.stands and end.connection not in self._calls:
                self._put(end, SYN_ACK)
            return
        end = StreamEnd(0, segment.connection, src, segment.to_port, segment.from_port, segment.v6)
        self._ends[end.connection] = end
        self._calls[end.connection] = max(1, self.processes)
        own, other = node_address(self._agent, segment.v6), node_address(src, segment.v6)
        self._deliver(65, _CALL.pack(end.connection, other, segment.from_port, own, segment.to_port), 0)

    def _acknowledged(self, end: StreamEnd, segment: Segment) -> None:
        end.window = segment.window
        size = segment.acknowledged - end.first
        if size > 0:
            if end.timed and segment.acknowledged > end.timed[0]:
                self._measure(end, self.now_ns - end.timed[1])
                end.timed = None
            data = min(size, len(end.unsent))
            del end.unsent[:data]
            end.first, end.next = segment.acknowledged, max(end.next, segment.acknowledged)
            end.tries = end.same = 0
            end.rto_ns = _time_out(end)  # what was doubled is so no more, as in Linux: its segments have time stamps
            end.due_ns = self.now_ns + end.rto_ns if end.first < end.next else None
            if data:
                self._acknowledge(end, data)
            if end.first < end.recover:
                self._again(end)
        elif not segment.data and segment.kind == DATA and end.first < end.next:
            end.same += 1
            if end.same == 3:
                end.recover = end.next
                self._again(end)
        self._pump(end)

    def _measure(self, end: StreamEnd, took_ns: int) -> None:
        if not end.smooth_ns:
            end.smooth_ns, end.deviation_ns = took_ns, took_ns // 2
        else:
            end.deviation_ns = (3 * end.deviation_ns + abs(end.smooth_ns - took_ns)) // 4
            end.smooth_ns = (7 * end.smooth_ns + took_ns) // 8

    def _arrived(self, end: StreamEnd, segment: Segment) -> None:
        if segment.kind == FIN:
            end.end_at = segment.sequence
        elif segment.sequence < end.expected + 2 * WINDOW:
            end.kept.setdefault(segment.sequence, segment.data)
        while (data := end.kept.pop(end.expected, None)) is not None:
            end.expected += len(data)
            if not end.closed:
                self._tell(end, 82, data)
        for sequence in [each for each in end.kept if each < end.expected]:
            del end.kept[sequence]
        if end.end_at == end.expected:
            end.expected += 1
            if not end.closed:
                self._tell(end, 90)
        self._put(end, DATA)

    def _put(self, end: StreamEnd, kind: int, sequence: int | None = None, data: bytes = b"") -> None:
        window = max(0, WINDOW - end.waiting)
        at = end.next if sequence is None else sequence
        # The other end's number of the connection differs in its last bit.
        ports, other = (end.from_port, end.to_port), end.connection ^ 1
        self._send(Segment(end.agent, *ports, kind, other, at, end.expected, window, end.v6, data))

    def _pump(self, end: StreamEnd) -> None:
        most = 1440 if end.v6 else 1460
        last = end.first + len(end.unsent)
        while end.stands and end.next < last and end.next < end.first + min(end.window, WINDOW):
            data = bytes(end.unsent[end.next - end.first : end.next - end.first + most])
            if end.timed is None:
                end.timed = (end.next, self.now_ns)
            self._put(end, DATA, end.next, data)
            end.next += len(data)
        if end.ends_at is not None and end.next == end.ends_at and end.stands:
            self._put(end, FIN, end.next)
            end.next += 1
        if end.due_ns is None and (end.first < end.next or (end.unsent and end.stands)):
            end.due_ns = self.now_ns + end.rto_ns  # also to ask a closed window again

    def _again(self, end: StreamEnd) -> None:
        """Send the first segment that is not acknowledged once more."""
        end.timed = None  # Karn: what was sent twice measures nothing
        if end.unsent:
            data = bytes(end.unsent[: 1440 if end.v6 else 1460])
            self._put(end, DATA, end.first, data)
            end.next = max(end.next, end.first + len(data))
        elif end.ends_at is not None:
            self._put(end, FIN, end.first)

    def tick(self, now_ns: int) -> None:
        """Let time pass: what was not acknowledged in time is sent again."""
        self.now_ns = now_ns
        for end in [each for each in self._ends.values() if each.due_ns is not None and each.due_ns <= now_ns]:
            end.tries += 1
            if end.tries > (TRIES if end.stands else SYN_TRIES):
                self._fail(end, errno.ETIMEDOUT)
                continue
            end.rto_ns = min(MOST_RTO_NS, 2 * end.rto_ns)
            end.due_ns = now_ns + end.rto_ns
            if end.stands:
                end.recover = end.next
                self._again(end)
            else:
                self._put(end, SYN)

    def _forget_if_done(self, end: StreamEnd) -> None:
        """Both directions have ended, and all is acknowledged."""
        done = end.ends_at is not None and end.first > end.ends_at
        if done and end.closed and end.end_at is not None and end.expected > end.end_at:
            self._ends.pop(end.connection, None)
        elif done:
            end.due_ns = None

    @property
    def busy(self) -> bool:
        """Whether something is on its way or will be sent again."""
        return any(end.due_ns is not None for end in self._ends.values())


def _time_out(end: StreamEnd) -> int:
    if not end.smooth_ns:
        return FIRST_RTO_NS
    return min(MOST_RTO_NS, max(LEAST_RTO_NS, end.smooth_ns + 4 * end.deviation_ns))


def _reset(src: int, of: Segment) -> Segment:
    return Segment(src, of.to_port, of.from_port, RST, of.connection ^ 1, 0, 0, 0, of.v6, b"")
