"""What a modem is given to send, and payloads that it sends until their receiver has acknowledged them.

The head of a frame of these begins with three bytes: whether it is an acknowledgement, or wants one, its number, and
the protocol number of the payload. A receiver takes each number once, since only its acknowledgement may have been
lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from netem.endpoint import HeardFrame, ModemChannel, SentFrame

_HEAD = 3  # bytes
CLEARED = "cleared"
_ACKNOWLEDGEMENT, _CARRIED, _ALONE = 0, 1, 2
_NUMBERS = 256
UNANSWERED = f"{_NUMBERS} payloads wait for their acknowledgements"
_REMEMBERED = 128  # numbers of a sender that are not taken again
_WAIT_S = 2.0  # beside travel and airtime, until an acknowledgement counts as missing


@dataclass(slots=True)
class Job:
    """A payload that waits, or is in the channel."""

    payload: bytes
    to: int  # an address; EVERYBODY: all
    what: int  # protocol number
    on_sent: Callable[[SentFrame], None] = lambda _: None
    on_dropped: Callable[[str], None] = lambda _: None  # gets the reason: a cause, or CLEARED
    head: bytes = b""  # see `netem.endpoint.ModemRequest`
    at_ns: int | None = None  # when it has to begin, of CLOCK_MONOTONIC; None: when it is its turn


@dataclass(slots=True)
class _Waiting:
    """A payload that waits for its acknowledgement."""

    frame: Job
    then: Callable[[HeardFrame | None], None]  # gets the acknowledgement; None: it was not delivered
    tries: int
    tried: int


class Deliveries:
    """The frames of one modem that are not acknowledged yet, and the last ones that it has taken from others."""

    def __init__(
        self,
        link: int,
        piggyback: int,
        channel: ModemChannel,
        put: Callable[[Job], None],
        call_after: Callable[[float, Callable[[], None]], None],
    ) -> None:
        """Begin. `link`, `piggyback`: protocol numbers of the frames, and of what comes with an acknowledgement. `put`
        lets one wait for its transmission; `call_after` calls something after a time [s]."""
        self._piggyback = piggyback
        self._link, self._channel, self._put, self._call_after = link, channel, put, call_after
        self._waiting: dict[int, _Waiting] = {}  # by number
        self._taken: dict[int, deque[int]] = {}  # by sender: its last numbers
        self._last = -1
        self._more: dict[int, bytes] = {}  # by address: what goes with the next acknowledgement

    def send(
        self, job: Job, tries: int, then: Callable[[HeardFrame | None], None], submit: Callable[[Job], str]
    ) -> str:
        """Send a payload. `submit` takes it for the first time, or says why not. Returns that; empty: `then` gets the
        acknowledgement, or None if the payload was not delivered."""
        free = (n % _NUMBERS for n in range(self._last + 1, self._last + 1 + _NUMBERS))
        number = next((n for n in free if n not in self._waiting), None)
        if number is None:
            return UNANSWERED

        def sent(frame: SentFrame) -> None:
            job.on_sent(frame)
            air_s, tried = (frame.airtime_ns + self._channel.modem.airtime_ns(0)) / 1e9, one.tried
            wait_s = self._channel.there_and_back_s + air_s + self._channel.access_s + _WAIT_S
            self._call_after(wait_s, lambda: self._late(number, one, tried))

        head = bytes((_CARRIED, number, job.what)) + job.head
        frame = replace(job, head=head, what=self._link, on_sent=sent)
        frame.on_dropped = lambda _: self._late(number, one, one.tried)
        one = _Waiting(frame, then, tries, 1)
        if why := submit(frame):
            return why
        self._last, self._waiting[number] = number, one
        return ""

    def unacknowledged(self, job: Job) -> Job:
        """A payload as a frame of the link that nobody acknowledges."""
        return replace(job, head=bytes((_ALONE, 0, job.what)) + job.head, what=self._link)

    def answer_with(self, to: int, payload: bytes) -> None:
        """Let a payload travel with the next acknowledgement for a modem, in place of an earlier one."""
        self._more[to] = payload

    def clear(self) -> None:
        """Give up everything that waits for its acknowledgement, or to travel with one."""
        waiting, self._waiting, self._more = self._waiting, {}, {}
        for one in waiting.values():
            one.then(None)

    def take_frame(self, frame: HeardFrame) -> HeardFrame | None:
        """Take a frame of the link. Returns what it carries; None: nothing that is new."""
        if len(frame.head) < _HEAD:
            return None
        kind, number, what = frame.head[:_HEAD]
        if kind == _ACKNOWLEDGEMENT:
            if number in self._waiting and self._waiting[number].frame.to == frame.src:
                self._waiting.pop(number).then(frame)
            return frame._replace(what=self._piggyback, head=b"") if frame.payload else None
        if kind == _ALONE:
            return frame._replace(what=what, head=frame.head[_HEAD:])
        more = self._more.pop(frame.src, b"")
        self._put(Job(more, frame.src, self._link, head=bytes((_ACKNOWLEDGEMENT, number, what))))
        taken = self._taken.setdefault(frame.src, deque(maxlen=_REMEMBERED))
        if number in taken:
            return None
        taken.append(number)
        return frame._replace(what=what, head=frame.head[_HEAD:])

    def _late(self, number: int, one: _Waiting, tried: int) -> None:
        if self._waiting.get(number) is not one or tried != one.tried:
            return
        if one.tried < one.tries:
            one.tried += 1
            self._put(one.frame)
        else:
            del self._waiting[number]
            one.then(None)
