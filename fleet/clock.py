"""The console's clock: how far the world may go.

Grant T means that ticks < T may be started. Grants run at most a window ahead of what the log has written, so a
slow disk slows the run and loses nothing, and with a speed at most that many times wall time.
"""

from __future__ import annotations

from dataclasses import dataclass

WINDOW_NS = 500_000_000  # sim time; also the latency of a live action


@dataclass(frozen=True, slots=True)
class Clock:
    """A grant policy over integer ticks.

    Raises nothing and keeps no state: `until` is a function of what is written and of the wall time passed.
    """

    ticks: int
    tick_ns: int
    round_ticks: int
    frame_every: int
    speed: float | None = None  # sim seconds per wall second; None: as fast as it goes

    @property
    def window(self) -> int:
        """Ticks ahead of the log. A tick is written once netem has reported the round after it, so the window
        spans at least two rounds and two frames, or nothing would ever move."""
        least = 2 * max(self.round_ticks, self.frame_every) + 1
        return max(WINDOW_NS // self.tick_ns, least)

    def until(self, written: int, wall_s: float) -> int:
        """The grant when ticks up to `written` are in the log and `wall_s` has passed since the start."""
        limit = min(written + 1 + self.window, self.ticks)
        if self.speed is None:
            return limit
        return min(limit, int(wall_s * self.speed * 1e9) // self.tick_ns + 1)
