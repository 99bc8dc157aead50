"""How the share of failures rises along an axis: the psychometric curve, and the steepest rise.

Where a pass rate falls through a level, from few runs: a Bayesian estimate, and where to run next.

Each run is a yes or no at a position x from 0 to 1, and the pass rate is taken for a logistic curve

    p(x) = guess + (1 - guess - lapse) / (1 + exp(-(logit(c) + (b - x) / s))), c so that p(b) = level,

whose border b, scale s and ends are not known: it falls from 1 - lapse to guess. A grid holds their posterior. The
next runs are those with the most expected information about b: QUEST+ (A. B. Watson, "QUEST+: a general
multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3), 2017), with the information about b
alone, as the others are of no interest, and for a batch of runs at once (A. Kirsch, J. van Amersfoort, Y. Gal,
"BatchBALD", NeurIPS 2019).

Half of the prior's borders lie beyond the range, at most half a range away: that a border is not within is an answer.
Most of its curves begin at 1 and end at 0. Without the others an interval held the truth in 65 to 84 % of cases with
a best pass rate of 0.7, and the border was 7 to 8 % of the range off. `docs/examples/boundary_methods.py --coverage`
measures the present values.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from math import comb
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
BEYOND = 0.5  # of the range, to both sides
BORDERS = 401  # of the grid
SCALES = np.geomspace(0.002, 0.4, 10)
# The ends of curves, as (lapse / (1 - level), guess / level), and how likely each is beforehand.
_OFF = (0.3, 0.6, 0.8)
ENDS = {
    (0.0, 0.0): 0.7,
    **{(off, 0.0): 0.04 for off in _OFF},
    **{(0.0, off): 0.04 for off in _OFF},
    **{(off, off): 0.03 for off in _OFF[:2]},
}
CONFIDENCE = 0.95
BATCH = 4  # runs of a border per round
DOUBTFUL, RISING = 0.05, 0.005  # chances of a rise at which it is looked at again, and at which it counts as one


class Belief(NamedTuple):
    """The present knowledge of the border; 0 and 1 are the ends of the range, and what lies beyond is a guess."""

    border: float  # the median of its posterior
    low: float  # the interval of 95 %
    high: float
    below: float  # the chances that it lies below 0, and above 1
    above: float


class PsychometricCurve:
    """Candidates for runs, and how each answer there depends on the border, and on the curve's scale and ends."""

    def __init__(self, positions: Sequence[float], level: float = 0.5) -> None:
        """Compute the table of answers. `positions`: where runs can be made, rising, from 0 to 1. `level`: the pass
        rate at the border, between 0 and 1."""
        self.positions = np.asarray(positions, dtype=np.float64)
        self.borders = np.linspace(-BEYOND, 1.0 + BEYOND, BORDERS)
        lapse = np.repeat([off * (1.0 - level) for off, _ in ENDS], len(SCALES))
        guess = np.repeat([off * level for _, off in ENDS], len(SCALES))
        middle = (level - guess) / (1.0 - guess - lapse)
        away = (self.borders[:, None] - self.positions[:, None, None]) / np.tile(SCALES, len(ENDS))
        falls = np.exp(-np.logaddexp(0.0, -(np.log(middle / (1.0 - middle)) + away)))
        self.passes: Array = guess + (1.0 - guess - lapse) * falls  # (position, border, scale and ends)
        self._prior = np.log(np.repeat(list(ENDS.values()), len(SCALES)))

    def posterior(self, runs: Iterable[tuple[int, bool]]) -> Array:
        """The chance of each (border, scale and ends) after runs: each the number of its position, and if it passed."""
        logs = np.zeros(self.passes.shape[1:]) + self._prior
        for (position, passed), count in sorted(Counter(runs).items()):
            chance = self.passes[position] if passed else 1.0 - self.passes[position]
            logs += count * np.log(np.maximum(chance, 1e-12))
        weights = np.exp(logs - logs.max())
        found: Array = weights / weights.sum()
        return found

    def belief(self, posterior: Array) -> Belief:
        of_border = posterior.sum(axis=1)
        rising = np.cumsum(of_border) - 0.5 * of_border  # half of a cell lies on either side of its middle
        tail = (1.0 - CONFIDENCE) / 2.0
        low, middle, high = np.interp([tail, 0.5, 1.0 - tail], rising, self.borders)
        below, above = of_border[self.borders < 0.0].sum(), of_border[self.borders > 1.0].sum()
        return Belief(float(middle), float(low), float(high), float(below), float(above))

    def most_informative(self, posterior: Array, count: int) -> list[int]:
        """The numbers of the positions of the next runs.

        Each in turn is the one with the most information, given those before it.
        """
        known = posterior[None]  # (answers so far, border, curve), together with those answers
        chosen: list[int] = []
        by_border = self.passes.transpose(1, 0, 2)
        for _ in range(count):
            passed = (by_border @ known.transpose(1, 2, 0)).transpose(1, 2, 0)  # (position, answers, border)
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


class Walk:
    """Where the runs of a border are made, one batch after the other, until enough is known."""

    def __init__(self, curve: PsychometricCurve, width: float) -> None:
        """Begin with both ends and two places between. `width`: of an interval that is narrow enough, as a share of the
        range."""
        self.curve = curve
        # Runs cannot tell where between two places a sharp border is.
        self._enough = max(width, 1.5 * float(np.diff(curve.positions).max()))
        last = len(curve.positions) - 1
        self._start = sorted({0, round(last / 3), round(2 * last / 3), last})

    def next_runs(self, runs: Sequence[tuple[int, bool]]) -> list[int]:
        if not runs:
            return self._start
        posterior = self.curve.posterior(runs)
        found = self.curve.belief(posterior)
        if found.high - found.low <= self._enough or max(found.below, found.above) > CONFIDENCE:
            rise = steepest_rise(runs)
            half = BATCH // 2
            return [rise.near] * half + [rise.far] * half if RISING < rise.chance < DOUBTFUL else []
        return self.curve.most_informative(posterior, BATCH)


class Rise(NamedTuple):
    """Two neighbouring groups of runs; the farther one passes more often."""

    near: int  # numbers of positions: of the last run of the nearer group, and of the first of the farther one
    far: int
    chance: float  # of such a difference or a larger one, if the pass rates are equal


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
