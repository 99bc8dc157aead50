"""When each message is played: a state machine over the due times of messages and a wall clock that is passed in.

Log time p and wall time t are related by p = p0 + rate (t - t0) while the player runs; every change (pause, rate,
seek) sets (p0, t0) anew. Rate 0 means as fast as possible. All times are integer ns.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Protocol

from fleet.option import Kind, Option

LATE_NS = 5_000_000  # a message that is handed out so long after it was due has missed its deadline
SEEK_NS = 5_000_000_000  # log time that a key press seeks
RATE_STEP = 1.1
SLOWEST, FASTEST = 0.001, 1e6


@dataclass(frozen=True, slots=True)
class PlaybackOptions:
    """What to play of a log, and how: the options of `fleet replay`. Times are in ns from the log's first message."""

    speed: Annotated[float, Kind.PACE, Option("Times the log's own pace; 0: as fast as possible.")] = 1.0
    start_ns: Annotated[int, Kind.TIME, Option("Begin at this time of the log, e.g. '20 s'.", flag="--start")] = 0
    end_ns: Annotated[int | None, Kind.TIME, Option("End at this time of the log.", flag="--end")] = None
    topics: Annotated[tuple[str, ...], Option(
        "Only this topic, or those that fit: uuv/*/state, link/**; repeatable.", "TOPIC")] = ()  # fmt: skip
    exclude: Annotated[tuple[str, ...], Option("Not this topic, or those that fit; repeatable.", "TOPIC")] = ()
    loop: Annotated[bool, Option("Begin again at the end, until Ctrl-C.")] = False
    step: Annotated[bool, Option("Begin with a pause; right arrow plays a tick, space goes on.")] = False
    wait_for_subscribers: Annotated[bool, Option("Begin when every key that is played has a subscriber.")] = False


class Times(Protocol):
    """A sequence of integers that never decreases: a list, or an array."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> int: ...


class Player:
    """Computes which messages are due at a wall time; the caller publishes them.

    `times` never decreases. Messages are named by their index in it; those from `begin_ns` to `end_ns`, both
    included, are played, each once a lap and in order.
    """

    def __init__(
        self,
        times: Times,
        begin_ns: int,
        end_ns: int,
        *,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
        now: int = 0,
        before: Callable[[int], int] | None = None,
    ) -> None:
        """Begin at `begin_ns`. `times`: when each message is due [ns of log time]. `rate`: log seconds per wall second;
        0: as fast as possible. `before`: how many messages are due before a time, if that is known without a search
        through all times."""
        self._times = times
        self._before = before or (lambda ns: bisect_left(times, ns))
        self.begin_ns, self.end_ns = begin_ns, max(begin_ns, end_ns)
        self._first = self._before(begin_ns)
        self._stop = self._before(self.end_ns + 1)
        self._next = self._first
        self.rate, self._loop, self.paused = rate, loop, paused
        self._origin = now, begin_ns
        self.missed = 0  # deadlines
        self.laps = 0  # completed ones

    @property
    def over(self) -> bool:
        """Whether every message has been played, and playing does not begin again."""
        return self._next >= self._stop and (not self._loop or self._first >= self._stop)

    @property
    def left(self) -> int:
        return self._stop - self._next

    def position(self, now: int) -> int:
        """The log time that is played at wall time `now`; it waits for a message that is not handed out yet."""
        wall, log = self._origin
        if self.paused or not self.rate:
            return log
        reached = min(log + int((now - wall) * self.rate), self.end_ns)
        return min(reached, int(self._times[self._next])) if self._next < self._stop else reached

    def due(self, now: int, most: int) -> range:
        """The next messages that are due, up to a number of them; they count as played."""
        if self.paused:
            return range(0)
        if self._next >= self._stop:
            if self.over or self._wait_for(self.end_ns, now) > 0:
                return range(0)
            self._lap(now)
        ready = min(self._stop, self._next + most)
        if self.rate:
            wall, log = self._origin
            ready = bisect_right(self._times, log + int((now - wall) * self.rate), self._next, ready)
        found = range(self._next, ready)
        if found:
            self._count_missed(found, now)
            self._next = found.stop
            if not self.rate:
                self._origin = now, int(self._times[found[-1]])
        return found

    def wait_ns(self, now: int) -> int | None:
        """Wall time until something is due; None when nothing will be unless something changes."""
        if self.paused or self.over:
            return None
        return self._wait_for(int(self._times[self._next]) if self._next < self._stop else self.end_ns, now)

    def pause(self, now: int) -> None:
        if not self.paused:
            self._origin = now, self.position(now)
            self.paused = True

    def resume(self, now: int) -> None:
        if self.paused:
            self._origin = now, self._origin[1]
            self.paused = False

    def toggle(self, now: int) -> None:
        if self.paused:
            self.resume(now)
        else:
            self.pause(now)

    def step(self, now: int) -> range:
        """Pause, and hand out the next message with all others of the same time: a tick of a run."""
        self.pause(now)
        if self._next >= self._stop:
            if self.over:
                return range(0)
            self._lap(now)
        at = int(self._times[self._next])
        found = range(self._next, min(self._before(at + 1), self._stop))
        self._next = found.stop
        self._origin = now, at
        return found

    def seek(self, now: int, log_ns: int) -> None:
        """Go to a log time, or to the nearer end; a pause remains one. Skipped messages are not handed out."""
        at = min(max(log_ns, self.begin_ns), self.end_ns)
        self._next = min(max(self._before(at), self._first), self._stop)
        self._origin = now, at

    def set_rate(self, now: int, rate: float) -> None:
        self._origin = now, self.position(now)
        self.rate = min(max(rate, SLOWEST), FASTEST) if rate else 0.0

    def stood_still(self, ns: int) -> None:
        """Shift the schedule by the time without a reader. Messages that were due meanwhile are then not late."""
        wall, log = self._origin
        self._origin = wall + ns, log

    def _lap(self, now: int) -> None:
        self.laps += 1
        self._next = self._first
        self._origin = now, self.begin_ns

    def _wait_for(self, log_ns: int, now: int) -> int:
        if not self.rate:
            return 0
        wall, log = self._origin
        # Rounded up: a moment too early nothing would be due, and the caller would come again at once.
        return max(0, wall - now + int((log_ns - log) / self.rate) + 1)

    def _count_missed(self, found: range, now: int) -> None:
        if self.rate:
            wall, log = self._origin
            before = log + int((now - LATE_NS - wall) * self.rate)
            self.missed += bisect_left(self._times, before, found.start, found.stop) - found.start


class MeasuredRate:
    """Log time per wall time over about the last second."""

    WINDOW_NS = 1_000_000_000

    def __init__(self) -> None:
        self._since: tuple[int, int] | None = None
        self.value = 0.0

    def restart(self) -> None:
        """Forget earlier positions: the player has jumped, or stands still."""
        self._since = None

    def update(self, now: int, position: int) -> float:
        """The rate, given the player's position [ns] at a wall time [ns]."""
        if self._since is None or position < self._since[1]:
            self._since = now, position
        elif now - self._since[0] >= self.WINDOW_NS:
            self.value = (position - self._since[1]) / (now - self._since[0])
            self._since = now, position
        return self.value
