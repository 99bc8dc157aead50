"""Whose turn it is: some agents at a time are asked, each tick after tick up to the next round.

A process that is woken between a hundred others finds little of its memory in the processor's caches, and its sample
takes twice as long as the same agent's next one. Between two rounds no vehicle depends on another, so one may take
several ticks while others wait.
"""

from __future__ import annotations

from collections import deque

from netem.wire.messages import Nav


class Turns:
    """Which navs may leave.

    A turn is over with the command of a round tick. What an agent needs for the ticks after that, it gets when all have
    passed it, so until then it gets no turn: who has one never waits for who has none.
    """

    def __init__(self, round_ticks: int, most: int) -> None:
        """Nobody has a turn.

        Args:
            round_ticks: ticks from one round to the next.
            most: agents that have a turn at a time.
        """
        self._round_ticks, self._most = round_ticks, most
        self._holders: set[int] = set()
        self._ready: deque[tuple[int, Nav]] = deque()
        self._early: deque[tuple[int, Nav]] = deque()  # for ticks after a round that not all have passed
        self._passed = -round_ticks  # the last round tick that all have passed

    @property
    def idle(self) -> bool:
        """Whether nobody has a turn."""
        return not self._holders

    def holds(self, i: int) -> bool:
        """Whether agent i has a turn: it has been asked and has not answered."""
        return i in self._holders

    def ask(self, i: int, nav: Nav) -> None:
        """Queue a nav of agent i; one that goes on between two rounds is the next to leave."""
        before = (nav.tick - 1) // self._round_ticks * self._round_ticks  # the round whose deliveries it needs
        if before > self._passed:
            self._early.append((i, nav))
        elif 0 <= before < nav.tick - 1:
            self._ready.appendleft((i, nav))
        else:
            self._ready.append((i, nav))

    def release(self, i: int) -> None:
        """Agent i has answered, or has ended."""
        self._holders.discard(i)

    def forget(self, i: int) -> None:
        """Agent i has ended."""
        self.release(i)
        self._ready = deque(item for item in self._ready if item[0] != i)
        self._early = deque(item for item in self._early if item[0] != i)

    def passed(self, tick: int) -> None:
        """All vehicles have passed a round tick."""
        self._passed = tick
        early, self._early = self._early, deque()
        for i, nav in early:
            self.ask(i, nav)

    def take(self) -> tuple[int, Nav] | None:
        """The next nav that may leave, or None when there is none now."""
        if not self._ready or len(self._holders) >= self._most:
            return None
        i, nav = self._ready.popleft()
        self._holders.add(i)
        return i, nav
