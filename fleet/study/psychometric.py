"""Where a pass rate falls through a level, from few runs: a Bayesian estimate, and where to run next.

Each run is a yes or no at a position x from 0 to 1, and the pass rate is taken for a logistic curve

    p(x) = 1 / (1 + exp(-(logit(level) + (b - x) / s))),

whose border b and scale s are not known. Their posterior is computed on a grid, and the next runs are those of
which the answers are expected to say most about b: QUEST+ (A. B. Watson, "QUEST+: a general multidimensional Bayesian
adaptive psychometric method", Journal of Vision 17(3), 2017), with the information about b alone, as s is of no
interest, and for a batch of runs at once (A. Kirsch, J. van Amersfoort, Y. Gal, "BatchBALD", NeurIPS 2019).

Half of the prior's borders lie beyond the range, at most half a range away: that a border is not within is an answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import comb, log
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
BEYOND = 0.5  # of the range, to both sides
BORDERS = 401  # of the grid
SCALES = np.geomspace(0.002, 0.4, 14)
CONFIDENCE = 0.95
DOUBTFUL, RISING = 0.05, 0.005  # chances of a rise at which it is looked at again, and at which it counts as one


class Belief(NamedTuple):
    """What is known of the border.

    Attributes:
        border: the median of its posterior.
        low, high: the interval of 95 %; below 0 and above 1 the place is a guess, but that it is outside is not.
        below, above: chances that the border lies below 0, and above 1.
    """

    border: float
    low: float
    high: float
    below: float
    above: float


class Curve:
    """Candidates for runs, and how each answer there depends on border and scale."""

    def __init__(self, positions: Sequence[float], level: float = 0.5) -> None:
        """Compute the table of answers.

        Args:
            positions: where runs can be made, rising, from 0 to 1.
            level: the pass rate at the border, between 0 and 1.
        """
        self.positions = np.asarray(positions, dtype=np.float64)
        self.borders = np.linspace(-BEYOND, 1.0 + BEYOND, BORDERS)
        logit = log(level / (1.0 - level)) + (self.borders[:, None] - self.positions[:, None, None]) / SCALES
        self.passes: Array = np.exp(-np.logaddexp(0.0, -logit))  # (position, border, scale)
        self._logs = np.log(np.maximum([1.0 - self.passes, self.passes], 1e-12))

    def posterior(self, runs: Iterable[tuple[int, bool]]) -> Array:
        """The chance of each (border, scale) after runs: each the number of its position, and whether it passed."""
        logs = np.zeros(self.passes.shape[1:])
        for position, passed in runs:
            logs += self._logs[int(passed), position]
        weights = np.exp(logs - logs.max())
        found: Array = weights / weights.sum()
        return found

    def belief(self, posterior: Array) -> Belief:
        """The border and its interval."""
        of_border = posterior.sum(axis=1)
        rising = np.cumsum(of_border) - 0.5 * of_border  # half of a cell lies on either side of its middle
        tail = (1.0 - CONFIDENCE) / 2.0
        low, middle, high = np.interp([tail, 0.5, 1.0 - tail], rising, self.borders)
        below, above = of_border[self.borders < 0.0].sum(), of_border[self.borders > 1.0].sum()
        return Belief(float(middle), float(low), float(high), float(below), float(above))

    def most_informative(self, posterior: Array, count: int) -> list[int]:
        """The numbers of the positions of the next runs: each in turn the one that says most, given those before it."""
        known = posterior[None]  # (answers so far, border, scale), together with those answers
        chosen: list[int] = []
        for _ in range(count):
            passed = np.einsum("abs,xbs->xab", known, self.passes, optimize=True)
            joint = np.concatenate(
                [passed, np.maximum(known.sum(axis=2) - passed, 0.0)], axis=1
            )  # (position, answers, border)
            answers = joint.sum(axis=2)
            # I(border; answers) = H(answers) - H(answers | border), but for what all positions share.
            gain = _xlogx(joint).sum(axis=(1, 2)) - _xlogx(answers).sum(axis=1)
            at = int(np.argmax(gain))
            chosen.append(at)
            p = self.passes[at]
            known = np.concatenate([known * p, known * (1.0 - p)])
        return sorted(chosen)


class Rise(NamedTuple):
    """Two neighbouring groups of runs, of which the farther one passes more often.

    Attributes:
        near, far: numbers of positions: of the last run of the nearer group, and of the first of the farther one.
        chance: of such a difference or a larger one, if the pass rates are equal.
    """

    near: int
    far: int
    chance: float


def steepest_rise(runs: Iterable[tuple[int, bool]]) -> Rise:
    """The rise that is least likely by chance, by Fisher's exact test; its chance is 1 if there is none."""
    counts: dict[int, list[int]] = {}
    for position, passed in runs:
        counts.setdefault(position, [0, 0])[passed] += 1
    places = sorted(counts)
    sums = np.cumsum([[0, 0], *(counts[place] for place in places)], axis=0).tolist()
    found = Rise(0, 0, 1.0)
    for split in range(1, len(places)):
        for begin in range(split):
            for end in range(split + 1, len(places) + 1):
                (fails, passes), (fails_so_far, passes_so_far), (fails_on, passes_on) = (
                    sums[begin], sums[split], sums[end],
                )  # fmt: skip
                chance = _fisher(
                    passes_so_far - passes, fails_so_far - fails, passes_on - passes_so_far, fails_on - fails_so_far
                )
                if chance < found.chance:
                    found = Rise(places[split - 1], places[split], chance)
    return found


def _fisher(passed: int, failed: int, passed_on: int, failed_on: int) -> float:
    """The chance that so few of the passes or fewer are in the first group (hypergeometric)."""
    first, second, passes = passed + failed, passed_on + failed_on, passed + passed_on
    ways = sum(comb(first, k) * comb(second, passes - k) for k in range(max(0, passes - second), passed + 1))
    return ways / comb(first + second, passes)


def _xlogx(values: Array) -> Array:
    found: Array = values * np.log(np.maximum(values, 1e-300))
    return found
