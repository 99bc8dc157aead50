"""Multilevel splitting: the probability of an event that is too rare to count.

| symbol | meaning |
|---|---|
| S | the score of a path: its least margin so far |
| L_1 > ... > L_K = 0 | levels; the event is S < 0 |
| N | effort: paths of a stage |
| R_k | of the N paths of stage k, those that reach L_k |

A path of stage k begins where a path of the stage before reached L_(k-1), chosen at random, and goes on with draws of
its own. With fixed levels the product of R_k / N is an unbiased estimate of the probability (M. J. J. Garvels, "The
splitting method in rare event simulation", 2000; fixed effort). Levels come from a pilot, whose paths are not used for
the estimate: each is the margin that a given share of the paths gets to (F. Cerou, A. Guyader, "Adaptive multilevel
splitting for rare event analysis", 2007). Repeats are independent, and their spread gives the interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf, sqrt
from statistics import NormalDist, fmean, stdev
from typing import NamedTuple

from netem.draws import bits

PURPOSE = "split"  # of the draws
MOST_LEVELS = 60
NOWHERE = b""


class Entrance(NamedTuple):
    """Where a path has reached a level.

    Attributes:
        best: its score there.
        state: to continue from; None: the path was over by then.
    """

    best: float
    state: bytes | None


START = Entrance(inf, NOWHERE)


class Ask(NamedTuple):
    """A path that is to be made."""

    start: Entrance
    salt: int
    level: float | None  # where it ends; None: it goes on to its end


class SplitPath(NamedTuple):
    """A path that was made.

    Attributes:
        best: its score.
        places: (score, state) wherever the score got smaller, in order.
        cost: what it took, in ticks or steps.
    """

    best: float
    places: Sequence[tuple[float, bytes]]
    cost: float


Make = Callable[[Sequence[Ask]], Sequence[SplitPath]]


class Repeat(NamedTuple):
    """One estimate.

    Attributes:
        probability: the estimate.
        shares: R_k / N of each stage.
        cost: of all paths.
        spread: the paths of the first stage differed. If not, the draws on the way do not matter.
    """

    probability: float
    shares: tuple[float, ...]
    cost: float
    spread: bool


@dataclass(frozen=True, slots=True)
class Splitting:
    """How to split."""

    effort: int = 100
    share: float = 0.25  # of the paths that a level of the pilot lets pass

    def levels(self, make: Make, seed: int) -> tuple[tuple[float, ...], float, bool]:
        """Levels from a pilot, what it cost, and whether the paths of its first stage differed."""
        found: list[float] = []
        entrances, cost, spread = [START], 0.0, True
        for stage in range(MOST_LEVELS):
            paths = self._paths(make, entrances, None, seed, stage)
            cost += sum(path.cost for path in paths)
            scores = sorted(path.best for path in paths)
            if stage == 0:
                spread = scores[0] != scores[-1]
            level = scores[ceil(self.share * self.effort) - 1]
            if found and level >= found[-1]:  # scores with steps: fewer than that share get to the next one
                level = max((score for score in scores if score < found[-1]), default=inf)
            if not spread or level < 0 or level == inf:
                break
            found.append(level)
            entrances = [_entrance(path, level) for path in paths if reached(path.best, level)]
        return (*found, 0.0), cost, spread

    def repeat(self, make: Make, levels: Sequence[float], seed: int) -> Repeat:
        """One estimate with fixed levels."""
        entrances, shares, cost, spread = [START], list[float](), 0.0, True
        probability = 1.0
        for stage, level in enumerate(levels):
            paths = self._paths(make, entrances, level, seed, stage)
            cost += sum(path.cost for path in paths)
            if stage == 0:
                spread = len({path.best for path in paths}) > 1
            entrances = [_entrance(path, level) for path in paths if reached(path.best, level)]
            shares.append(len(entrances) / self.effort)
            probability *= shares[-1]
            if not entrances:
                break
        return Repeat(probability, tuple(shares), cost, spread)

    def _paths(
        self, make: Make, entrances: Sequence[Entrance], level: float | None, seed: int, stage: int
    ) -> list[SplitPath]:
        """N paths from entrances that are chosen at random; who is at the level already is not made again."""
        asks = []
        for n in range(self.effort):
            start = entrances[bits(seed, PURPOSE, stage, n, 0) % len(entrances)]
            asks.append(Ask(start, 1 + bits(seed, PURPOSE, stage, n, 1) % (2**62), level))
        over = [
            ask.start.state is None or (level is not None and reached(ask.start.best, level)) for ask in asks
        ]  # nothing is left to find out
        made = iter(make([ask for ask, known in zip(asks, over, strict=True) if not known]))
        found = []
        for ask, known in zip(asks, over, strict=True):
            best, state = ask.start
            path = SplitPath(best, () if state is None else ((best, state),), 0.0) if known else next(made)
            found.append(path if known else path._replace(best=min(path.best, best)))
        return found


def reached(score: float, level: float) -> bool:
    """Whether a score is at a level; at the last one only below it."""
    return score < 0.0 if level == 0.0 else score <= level


def _entrance(path: SplitPath, level: float) -> Entrance:
    """The first place at which a path reached a level."""
    first = next(((best, state) for best, state in path.places if reached(best, level)), None)
    return Entrance(path.best, None) if first is None else Entrance(*first)


def interval(estimates: Sequence[float], confidence: float = 0.95) -> tuple[float, float, float]:
    """The mean of independent estimates, and Student's interval for it, not below 0; (mean, 0, inf) of fewer than 3."""
    mean = fmean(estimates)
    if (freedom := len(estimates) - 1) < 2:
        return mean, 0.0, inf
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    # Student's quantile from the normal one (Abramowitz and Stegun, 26.7.5).
    t = z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    t += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    half = t * stdev(estimates) / sqrt(len(estimates))
    return mean, max(0.0, mean - half), mean + half
