"""When ticks begin on a wall clock. Nothing here reads one: whoever asks says what time it is."""

from __future__ import annotations


class TickSchedule:
    """Tick k begins one period after tick k - 1, until the clock is moved because somebody was too late for it."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self._tick, self._at_ns = 0, 0
        self.held_ns = 0  # moved because the ticks were not granted yet: paused, or waiting for a restart
        self.slipped_ns = 0  # moved because the world itself was late

    def start(self, tick: int, now_ns: int) -> None:
        """That tick begins now."""
        self._tick, self._at_ns = tick, now_ns

    def at_ns(self, tick: int) -> int:
        """When a tick begins."""
        return self._at_ns + (tick - self._tick) * self.period_ns

    def begin(self, tick: int, now_ns: int, *, held: bool) -> int:
        """A tick begins: how late it is [ns].

        A world that is up to a period late shortens the tick and so catches up. Beyond that, or when the console held
        the clock, the clock is moved: everyone gets the whole of every tick, and the run takes longer.
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
