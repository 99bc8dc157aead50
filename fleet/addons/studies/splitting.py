"""Multilevel splitting: the probability of an event that is too rare to count.

| symbol | meaning |
|---|---|
| S | the score of a path: its least margin so far |
| L_1 > ... > L_K = 0 | levels; the event is S < 0 |
| N | effort: paths of a stage |
| R_k | of the N paths of stage k, those that reach L_k |

A path of stage k begins where a path of the stage before reached L_(k-1), chosen at random, and goes on with draws
of its own. With fixed levels the product of R_k / N is an unbiased estimate of the probability (M. J. J. Garvels,
"The splitting method in rare event simulation", 2000; fixed effort). Levels come from a pilot, whose paths are not
used for the estimate: each is the margin that a given share of the paths gets to (F. Cerou, A. Guyader, "Adaptive
multilevel splitting for rare event analysis", 2007). Repeats are independent, and their spread gives the interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, copysign, inf, sqrt
from statistics import NormalDist, fmean, pstdev, stdev
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from fleet.addons.studies.branches import Way
from fleet.addons.studies.row import PartRow
from netem.draws import bits

PURPOSE = "split"  # of the draws
MOST_LEVELS = 60
NOWHERE: Way = ()


class RareRepeat(Struct, frozen=True):
    """One independent estimate."""

    seed: Annotated[int, Meta(description="Of what is drawn before the run begins.")]
    probability: Annotated[float, Meta(description="The estimate.", ge=0.0, le=1.0)]
    shares: Annotated[tuple[float, ...], Meta(description="Of the paths of each stage, those that reached its level.")]
    ticks: Annotated[float, Meta(description="Ticks that were simulated.")]
    spread: Annotated[bool, Meta(description="Whether what is drawn on the way made a difference.")]


class Entrance(NamedTuple):
    """Where a path has reached a level."""

    best: float  # its score there
    way: Way | None  # to continue from; None: the path was over by then


START = Entrance(inf, NOWHERE)


class SplitPath(NamedTuple):
    """A path that was made."""

    best: float
    entrances: list[Entrance]  # where its margin was smaller than ever before, in order
    ticks: int


class Ask(NamedTuple):
    """A path that is to be made."""

    start: Entrance
    salt: int
    level: float | None  # where it ends; None: it goes on to its end


Make = Callable[[Sequence[Ask]], Sequence[PartRow]]


@dataclass(frozen=True, slots=True)
class Splitting:
    effort: int = 100
    share: float = 0.25  # of the paths that a level of the pilot lets pass

    def levels(self, make: Make, seed: int) -> tuple[tuple[float, ...], float, bool]:
        """Levels from a pilot, what it cost, and whether the paths of its first stage differed."""
        found: list[float] = []
        entrances, cost, spread = [START], 0.0, True
        for stage in range(MOST_LEVELS):
            paths = self._paths(make, entrances, None, seed, stage)
            cost += sum(path.ticks for path in paths)
            scores = sorted(path.best for path in paths)
            if stage == 0:
                spread = scores[0] != scores[-1]
            level = scores[ceil(self.share * self.effort) - 1]
            if found and level >= found[-1]:  # scores with steps: fewer than that share get to the next one
                level = max((score for score in scores if score < found[-1]), default=inf)
            if not spread or level < 0 or level == inf:
                break
            found.append(level)
            entrances = [_entrance(path, level) for path in paths if is_reached(path.best, level)]
        return (*found, 0.0), cost, spread

    def repeat(self, make: Make, levels: Sequence[float], seed: int) -> RareRepeat:
        entrances, shares, cost, spread = [START], list[float](), 0.0, True
        probability = 1.0
        for stage, level in enumerate(levels):
            paths = self._paths(make, entrances, level, seed, stage)
            cost += sum(path.ticks for path in paths)
            if stage == 0:
                spread = len({path.best for path in paths}) > 1
            entrances = [_entrance(path, level) for path in paths if is_reached(path.best, level)]
            shares.append(len(entrances) / self.effort)
            probability *= shares[-1]
            if not entrances:
                break
        return RareRepeat(seed, probability, tuple(shares), cost, spread)

    def _paths(
        self, make: Make, entrances: Sequence[Entrance], level: float | None, seed: int, stage: int
    ) -> list[SplitPath]:
        asks = []
        for n in range(self.effort):
            start = entrances[bits(seed, PURPOSE, stage, n, 0) % len(entrances)]
            asks.append(Ask(start, 1 + bits(seed, PURPOSE, stage, n, 1) % (2**62), level))
        over = [
            ask.start.way is None or (level is not None and is_reached(ask.start.best, level)) for ask in asks
        ]  # nothing is left to find out
        made = iter(make([ask for ask, known in zip(asks, over, strict=True) if not known]))
        found = []
        for ask, known in zip(asks, over, strict=True):
            start = ask.start
            if known:
                found.append(SplitPath(start.best, [] if start.way is None else [start], 0))
                continue
            part = next(made)
            way = start.way or NOWHERE
            entrances = [Entrance(margin, (*way, (ask.salt, tick))) for margin, tick in part.places]
            found.append(SplitPath(min(part.best, start.best), entrances, part.ticks))
        return found


def is_reached(score: float, level: float) -> bool:
    """Whether a score is at a level; at the last one only below it."""
    return score < 0.0 if level == 0.0 else score <= level


def _entrance(path: SplitPath, level: float) -> Entrance:
    first = next((entrance for entrance in path.entrances if is_reached(entrance.best, level)), None)
    return first or Entrance(path.best, None)


def interval(estimates: Sequence[float], confidence: float = 0.95) -> tuple[float, float, float]:
    """The mean of independent estimates and an interval for it, not below 0; (mean, 0, inf) of fewer than 3.

    It is Student's, corrected for the skewness of the estimates (P. Hall, "On the removal of skewness by
    transformation", J. R. Statist. Soc. B 54(1), 1992). Without skewness it is Student's.
    """
    mean, count = fmean(estimates), len(estimates)
    if (freedom := count - 1) < 2:
        return mean, 0.0, inf
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    # Student's quantile from the normal one (Abramowitz and Stegun, 26.7.5).
    t = z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    t += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    spread = pstdev(estimates, mean)
    skewness = fmean(((one - mean) / spread) ** 3 for one in estimates) if spread else 0.0
    g, error = skewness / sqrt(count), stdev(estimates, mean) / sqrt(count)

    def quantile(t: float) -> float:
        """The t whose transform t + g t^2 / 3 + g^2 t^3 / 27 + g / 6 is Student's: Hall's cube inverted."""
        if abs(g) < 1e-6:
            return t
        cube = 1.0 + g * (t - g / 6.0)
        return 3.0 / g * (copysign(abs(cube) ** (1.0 / 3.0), cube) - 1.0)

    return mean, max(0.0, mean - error * quantile(t)), mean - error * quantile(-t)
