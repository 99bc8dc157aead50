"""The consensus-based bundle algorithm (CBBA; Choi, Brunet, How 2009): which vehicle does which task.

Every vehicle puts tasks into a bundle, one by one. It considers the tasks for which its bid is higher than all bids
that it knows. Of these it takes the task that adds most to the score of its path. Then neighbours exchange their
beliefs, and Table I of the paper says which belief wins. A vehicle that is outbid for a task gives up that task and all
later ones in its bundle, and chooses anew.

| symbol | meaning | unit |
|---|---|---|
| z_j | who has won task j, as far as is known; 0: nobody | - |
| y_j | the winner's bid; 0: nobody's | 1 |
| s_m | tick of the newest news of vehicle m, however they came | tick |
| b, p | bundle in the order of choosing; path in the order of visiting | - |

Of equal bids that of the smaller number wins. A bid is never more than the one before it in the bundle: a vehicle moves
between two bids, so its gains need not diminish by themselves (Johnson, Choi, How 2012).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

NOBODY = 0

Score = Callable[[Sequence[int]], float]  # the score of a path, which may hold any tasks


class News(NamedTuple):
    """The beliefs of a vehicle: the message of the algorithm."""

    bids: Sequence[float]  # y
    winners: Sequence[int]  # z
    heard: Mapping[int, int]  # s; the sender's own is the tick of the message


class Bidder:
    """One vehicle's part in the auction."""

    def __init__(self, number: int, tasks: int, size: int) -> None:
        """Begin with no bid. `number`: of the vehicle, above 0. `tasks`: how many there are; they are numbered from 0.
        `size`: of the bundle, at most."""
        self.number = number
        self.size = size
        self.bids = [0.0] * tasks
        self.winners = [NOBODY] * tasks
        self.heard: dict[int, int] = {}
        self.bundle: list[int] = []
        self.path: list[int] = []

    def choose(self, score: Score, closed: frozenset[int] = frozenset()) -> None:
        """Fill the bundle (the paper's first phase). `score`: of a path. `closed`: finished tasks, which get no more
        bids."""
        limit = min((self.bids[j] for j in self.bundle), default=float("inf"))
        while len(self.bundle) < self.size:
            best: tuple[float, int, list[int]] | None = None
            before = score(self.path)
            for j in range(len(self.bids)):
                if j in self.bundle or j in closed:
                    continue
                paths = [[*self.path[:n], j, *self.path[n:]] for n in range(len(self.path) + 1)]
                gain, path = max(((score(path), path) for path in paths), key=lambda one: one[0])
                bid = min(gain - before, limit)
                if bid <= 0.0 or not outbids(bid, self.number, self.bids[j], self.winners[j]):
                    continue
                if best is None or bid > best[0]:
                    best = bid, j, path
            if best is None:
                return
            limit, j, self.path = best
            self.bundle.append(j)
            self.bids[j], self.winners[j] = limit, self.number

    def hear(self, sender: int, news: News) -> None:
        """Believe what a neighbour says where it knows better (the second phase, Table I). `sender`: the neighbour.
        `news`: its message; `heard[sender]` is the tick of it. Older news is ignored."""
        said = news.heard[sender]
        if said <= self.heard.get(sender, -1):
            return
        for j, (bid, winner) in enumerate(zip(news.bids, news.winners, strict=True)):
            match self._action(sender, news, j):
                case "update":
                    self.bids[j], self.winners[j] = bid, winner
                case "reset":
                    self.bids[j], self.winners[j] = 0.0, NOBODY
        for m, tick in news.heard.items():
            if m != self.number:
                self.heard[m] = max(tick, self.heard.get(m, -1))
        self._give_up()

    def forget(self, vehicle: int) -> bool:
        """Take all tasks from a vehicle that is believed to be gone; returns whether it had any."""
        lost = [j for j, winner in enumerate(self.winners) if winner == vehicle]
        for j in lost:
            self.bids[j], self.winners[j] = 0.0, NOBODY
        return bool(lost)

    def finish(self, task: int) -> bool:
        """Take a task that is done out of the bundle; returns whether it was in it."""
        if task not in self.bundle:
            return False
        self.bundle.remove(task)
        self.path.remove(task)
        return True

    def _action(self, k: int, news: News, j: int) -> str:
        """What to do about task j: update, reset, or leave."""
        i, ours, theirs = self.number, self.winners[j], news.winners[j]

        def newer(m: int) -> bool:
            return news.heard.get(m, -1) > self.heard.get(m, -1)

        def higher() -> bool:
            return outbids(news.bids[j], theirs, self.bids[j], ours)

        if theirs == k:
            if ours in (k, NOBODY):
                return "update"
            return "update" if higher() or (ours != i and newer(ours)) else "leave"
        if theirs == i:
            if ours == k:
                return "reset"
            return "reset" if ours not in (i, NOBODY) and newer(ours) else "leave"
        if theirs == NOBODY:
            if ours == k:
                return "update"
            return "update" if ours not in (i, NOBODY) and newer(ours) else "leave"
        # theirs is somebody else, m.
        if ours == i:
            return "update" if newer(theirs) and higher() else "leave"
        if ours == k:
            return "update" if newer(theirs) else "reset"
        if ours in (theirs, NOBODY):
            return "update" if newer(theirs) else "leave"
        if newer(theirs) and (newer(ours) or higher()):
            return "update"
        return "reset" if newer(ours) and self.heard.get(theirs, -1) > news.heard.get(theirs, -1) else "leave"

    def _give_up(self) -> None:
        """Release the first task of the bundle that somebody else has now, and all chosen after it."""
        kept = next((n for n, j in enumerate(self.bundle) if self.winners[j] != self.number), len(self.bundle))
        for j in self.bundle[kept:]:
            if self.winners[j] == self.number:
                self.bids[j], self.winners[j] = 0.0, NOBODY
            self.path.remove(j)
        del self.bundle[kept:]


def outbids(bid: float, bidder: int, other: float, winner: int) -> bool:
    """Whether a bid beats that of the winner so far; of equal ones that of the smaller number does."""
    return winner == NOBODY or bid > other or (bid == other and bidder < winner)


def rounds_needed(tasks: int, vehicles: int, size: int, diameter: int) -> int:
    """The published bound: after this many rounds without loss no two vehicles claim one task, and all know its winner.
    `diameter`: hops from any vehicle to any other, at most."""
    return min(tasks, vehicles * size) * diameter
