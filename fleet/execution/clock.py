"""The console's clock: how far the world may go.

Grant T means that ticks < T may be started. Grants run at most a window ahead of what the log has written, so a
slow disk slows the run and loses nothing, and with a speed limit at most that many times wall time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from fleet.scenario.scenario import Scenario, frame_every
from netem.clock import Clock

# Simulated time that grants go beyond the log. It keeps a run near its log, and it is the latency of a live action.
WINDOW_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class GrantPolicy:
    """A grant policy over integer ticks. It keeps no state: `until` depends on what is written and on the wall time."""

    ticks: int
    tick_ns: int
    round_ticks: int
    frame_every: int
    speed_limit: float | None = None  # sim seconds per wall second; None: as fast as it goes
    lead_ns: int = 0  # sim time by which grants go ahead of that limit: in real time the world itself keeps the speed
    begin: int = 0  # the tick at which the run begins, from which the speed counts

    @classmethod
    def of(cls, scenario: Scenario, speed_limit: float | None = None, *, lead_ns: int = 0, begin: int = 0) -> Self:
        m = scenario.round_ticks
        return cls(scenario.ticks, scenario.tick_ns, m, frame_every(scenario), speed_limit, lead_ns, begin)

    @property
    def window(self) -> int:
        """Ticks ahead of the log. A tick is written once netem has reported the round after it, so the window
        spans at least two rounds and two frames, or nothing would ever move."""
        least = 2 * max(self.round_ticks, self.frame_every) + 1
        return max((WINDOW_NS + 2 * self.lead_ns) // self.tick_ns, least)

    def until(self, written: int, wall_s: float) -> int:
        """The grant when ticks up to `written` are in the log and `wall_s` have passed since the start."""
        limit = min(written + 1 + self.window, self.ticks)
        if self.speed_limit is None:
            return limit
        passed_ns = int(wall_s * self.speed_limit * 1e9) + self.lead_ns
        return min(limit, self.begin + passed_ns // self.tick_ns + 1)


class LiveClock:
    """A grant policy that an operator may pause, step, slow down and speed up while it runs."""

    def __init__(self, policy: GrantPolicy, now: float) -> None:
        self._policy = policy
        self.speed_limit = policy.speed_limit  # the greatest speed, in multiples of real time; None: no limit
        self._origin = now, 0  # wall time and tick from which the speed counts
        self._now = now
        self._held: int | None = None  # paused at this grant

    @property
    def clock(self) -> Clock:
        """The clock that decides when a tick begins; the speed of a wall clock cannot change."""
        return Clock.REAL if self._policy.lead_ns else Clock.LOCKSTEP

    @property
    def held(self) -> int:
        """The grant of the pause."""
        assert self._held is not None
        return self._held

    @property
    def paused(self) -> bool:
        return self._held is not None

    def until(self, written: int, now: float) -> int:
        """The grant when ticks up to `written` are in the log, at wall time `now` [s]."""
        self._now = now
        since, tick = self._origin
        speed_limit = self.speed_limit if self._held is None else None
        limit = replace(self._policy, speed_limit=speed_limit, begin=tick).until(written, now - since)
        return limit if self._held is None else min(limit, self._held)

    def pause(self, granted: int) -> None:
        self._held = granted if self._held is None else self._held

    def resume(self) -> None:
        if self._held is not None:
            self._origin = self._now, self._held
            self._held = None

    def step(self, granted: int, ticks: int) -> None:
        self._held = min(granted + ticks, self._policy.ticks)

    def set_speed_limit(self, granted: int, speed_limit: float | None) -> None:
        """From now on go at most at this speed, in multiples of real time; None: as fast as possible."""
        self.speed_limit = speed_limit
        self._origin = self._now, granted

    def describe(self) -> str:
        """The state in words: `paused`, `as fast as it goes`, `2 x real time`."""
        if self.paused:
            return "paused"
        return "as fast as it goes" if self.speed_limit is None else f"{self.speed_limit:g} x real time"
