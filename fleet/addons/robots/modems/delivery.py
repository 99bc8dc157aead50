"""What a modem is given to send, and payloads that it sends until their receiver has acknowledged them.

A frame of these has three bytes before its data: whether it is an acknowledgement, its number, and the protocol number
of the payload. A receiver takes each number once, since only its acknowledgement may have been lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from netem.cause import Cause
from netem.endpoint import HeardFrame, Sea, SentFrame

HEADER = 3  # bytes
_ACKNOWLEDGEMENT, _CARRIED = 0, 1
_NUMBERS = 256
_WAIT_S = 2.0  # beside travel and airtime, until an acknowledgement counts as missing


@dataclass(slots=True)
class Job:
    """A payload that waits, or is in the channel."""

    payload: bytes
    to: int  # an address; EVERYBODY: all
    what: int  # protocol number
    sent: Callable[[SentFrame], None] = lambda _: None
    dropped: Callable[[Cause], None] = lambda _: None


@dataclass(slots=True)
class _Waiting:
    """A payload that waits for its acknowledgement."""

    frame: Job
    then: Callable[[bool], None]  # learns whether it was delivered
    tries: int  # that are left
    tried: int = 0


class Deliveries:
    """The frames of one modem that are not acknowledged yet, and the last ones that it has taken from others."""

    def __init__(
        self, link: int, sea: Sea, submit: Callable[[Job], str], after: Callable[[float, Callable[[], None]], None]
    ) -> None:
        """Begin. `link`: protocol number of the frames. `submit` takes one, as that of `ModemCore` does; `after` calls
        something after a time [s]."""
        self._link, self._sea, self._submit, self._after = link, sea, submit, after
        self._waiting: dict[int, _Waiting] = {}  # by number
        self._taken: dict[int, int] = {}  # by sender: the last number
        self._last = -1

    def send(self, job: Job, tries: int, then: Callable[[bool], None]) -> str:
        """Send a payload. Returns why that cannot be; empty: `then` learns whether it was delivered."""
        free = (n % _NUMBERS for n in range(self._last + 1, self._last + 1 + _NUMBERS))
        number = next((n for n in free if n not in self._waiting), None)
        if number is None:
            return f"{_NUMBERS} payloads wait for their acknowledgements"

        def sent(frame: SentFrame) -> None:
            job.sent(frame)
            air_s, tried = (frame.airtime_ns + self._sea.modem.airtime_ns(HEADER)) / 1e9, one.tried
            wait_s = self._sea.there_and_back_s + air_s + self._sea.access_s + _WAIT_S
            self._after(wait_s, lambda: self._late(number, one, tried))

        payload = bytes((_CARRIED, number, job.what)) + job.payload
        frame = replace(job, payload=payload, what=self._link, sent=sent)
        frame.dropped = lambda _: self._late(number, one, one.tried)
        one = _Waiting(frame, then, tries)
        if why := self._try(one):
            return why
        self._last, self._waiting[number] = number, one
        return ""

    def heard(self, frame: HeardFrame) -> HeardFrame | None:
        """Take a frame of the link. Returns what it carries; None: nothing that is new."""
        if len(frame.payload) < HEADER:
            return None
        kind, number, what = frame.payload[:HEADER]
        if kind == _ACKNOWLEDGEMENT:
            if number in self._waiting and self._waiting[number].frame.to == frame.src:
                self._waiting.pop(number).then(True)
            return None
        self._submit(Job(bytes((_ACKNOWLEDGEMENT, number, what)), frame.src, self._link))
        if self._taken.get(frame.src) == number:
            return None
        self._taken[frame.src] = number
        return frame._replace(what=what, payload=frame.payload[HEADER:])

    def _try(self, one: _Waiting) -> str:
        one.tried += 1
        one.tries -= 1
        return self._submit(one.frame)

    def _late(self, number: int, one: _Waiting, tried: int) -> None:
        if self._waiting.get(number) is not one or tried != one.tried:
            return
        if not one.tries or self._try(one):
            del self._waiting[number]
            one.then(False)
