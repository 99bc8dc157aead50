"""When ticks begin on a wall clock. Nothing here reads a clock: the caller passes the time."""

from __future__ import annotations


class TickSchedule:
    """Tick k begins one period after tick k - 1, unless the schedule was moved because a tick was late."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self._tick, self._at_ns = 0, 0
        self.held_ns = 0  # moved because the ticks were not granted yet: paused, or waiting for a restart
        self.slipped_ns = 0  # moved because the world itself was late

    def start(self, tick: int, now_ns: int) -> None:
        """Let a tick begin at `now_ns` [ns], and the next ones at one period each."""
        self._tick, self._at_ns = tick, now_ns

    def at_ns(self, tick: int) -> int:
        """When a tick begins [ns]."""
        return self._at_ns + (tick - self._tick) * self.period_ns

    def begin(self, tick: int, now_ns: int, *, held: bool) -> int:
        """Begin the next tick; returns how late it is [ns]. `held`: it was granted only now.

        A world that is up to a period late shortens the tick and so catches up. Beyond that, or when the console held
        the clock, the schedule is moved: every tick has its whole length, and the run takes longer.
        """
        late = now_ns - self.at_ns(tick)
        if held:
            self.held_ns += max(0, late)
            self.start(tick, now_ns)
            return 0
        if late > self.period_ns:
            self.slipped_ns += late
            self.start(tick, now_ns)
        return max(0, late)
