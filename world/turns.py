"""The world asks a few processes at a time, each tick after tick up to the next round.

If a hundred processes wake in turn, each finds little of its memory in the processor's caches. The first sample after
the wake-up takes twice as long as the next one. Between two rounds no vehicle depends on another. So one agent may
answer several ticks while others wait.

With 100 vehicles on two processors a tick takes 25 ms of CPU time if four agents are asked at a time, and 33 ms with
sixteen. External agents are all asked at once, because a distant agent would keep its turn while its answer travels.
The order cannot stop a run: an agent gets its turn when the round before is complete.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable

from netem.wire.credentials import WORLD as WORLD
from netem.wire.messages import (
    Nav,
)

Turn = list[tuple[int, Nav]]  # vehicles, whose agents are asked in one message, and what they are asked


class TickOrder:
    """Which navs may leave.

    An agent's turn is over with the command of a round tick. It gets the navs after that tick when all agents have
    passed it. Until then it gets no turn, so an agent with a turn never waits for one without. Agents of one process
    have their turns together.
    """

    def __init__(self, round_ticks: int, most: int, process: Callable[[int, Nav], Hashable] = lambda i, _: i) -> None:
        """No agent has a turn; at most `most` processes get one at a time. `process`: that of the agent that gets a
        nav; by default each agent has its own.
        """
        self._round_ticks, self._most, self._process = round_ticks, most, process
        self._asked: dict[int, Hashable] = {}  # agents that have a turn, and their processes
        self._holders: dict[Hashable, int] = {}  # how many agents with a turn each process has
        self._waiting: dict[Hashable, Turn] = {}  # navs that wait, by process
        self._ready: deque[Hashable] = deque()  # processes with navs that wait for a turn
        self._going: deque[Hashable] = deque()  # processes with navs that need no turn, since the process has one
        self._early: list[tuple[int, Nav]] = []  # navs for ticks after a round that not all have passed
        self._passed = -round_ticks  # the last round tick that all have passed

    @property
    def idle(self) -> bool:
        return not self._asked

    def holds(self, i: int) -> bool:
        """Whether agent i has a turn: it has been asked and has not answered."""
        return i in self._asked

    def ask(self, i: int, nav: Nav) -> None:
        """Queue a nav of agent i. If the agent continues between two rounds, its nav is the next to leave."""
        before = (nav.tick - 1) // self._round_ticks * self._round_ticks  # the round whose deliveries it needs
        if before > self._passed:
            self._early.append((i, nav))
            return
        process = self._process(i, nav)
        if process in self._waiting:
            self._waiting[process].append((i, nav))
            return
        self._waiting[process] = [(i, nav)]
        if process in self._holders:
            self._going.append(process)
        elif 0 <= before < nav.tick - 1:
            self._ready.appendleft(process)
        else:
            self._ready.append(process)

    def release(self, i: int) -> None:
        """Agent i has answered, or has ended."""
        process = self._asked.pop(i, None)
        if process is None:
            return
        if self._holders[process] == 1:
            del self._holders[process]
        else:
            self._holders[process] -= 1

    def forget(self, i: int) -> None:
        self.release(i)
        self._early = [item for item in self._early if item[0] != i]
        self._waiting = {
            process: left
            for process, turn in self._waiting.items()
            if (left := [item for item in turn if item[0] != i])
        }
        for queue in (self._ready, self._going):
            still = [process for process in queue if process in self._waiting]
            queue.clear()
            queue.extend(still)

    def on_round_passed(self, tick: int) -> None:
        """All vehicles have passed a round tick."""
        self._passed = tick
        early, self._early = self._early, []
        for i, nav in early:
            self.ask(i, nav)

    def take(self) -> Turn | None:
        """The next navs that may leave, all for one process, or None when there are none now."""
        if self._going:
            process = self._going.popleft()
        elif self._ready and len(self._holders) < self._most:
            process = self._ready.popleft()
        else:
            return None
        turn = self._waiting.pop(process)
        for i, _ in turn:
            self._asked[i] = process
        self._holders[process] = self._holders.get(process, 0) + len(turn)
        return turn
