"""How sure a study is: intervals of pass rates and medians, and two series over the same seeds compared in pairs.

Packets' fates are hashed draws of seed, link and number: runs with the same seed meet the same network, whatever their
controller. So two controllers are compared seed by seed, which needs far fewer runs than two independent series.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from math import isfinite, isnan, nan
from typing import NamedTuple

import numpy as np

CONFIDENCE = 0.95
LEAST = 6  # values, for the interval of a median or a test of pairs: five of one side have a chance of 2 / 2^5 = 6 %


class Estimate(NamedTuple):
    """A number of several runs and its interval; NaN where there are too few.

    `level` is the chance that such an interval holds the true number. That of a pass rate is nominal; that of a median
    is exact for values that are all different, and else a lower bound.
    """

    value: float  # inf: half of the runs or more have none, and that counts as larger than every number
    low: float
    high: float
    runs: int  # behind it, those with inf included
    level: float = nan  # 0.95 and more; NaN: there is no interval

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2


class PairedComparison(NamedTuple):
    """A second series against a first one, run by run with the same seed."""

    difference: Estimate  # the median of second - first
    better: float  # share of pairs in which the second is smaller, ties by half; 0.5: no difference
    p: float  # of the two-sided sign test, exact; NaN: too few pairs that differ
    note: str = ""  # why no difference can be found; "": one can


def pass_rate(passed: int, runs: int, confidence: float = CONFIDENCE) -> Estimate:
    """The share of runs that passed, with its Wilson score interval. `runs`: with a verdict; 0 gives NaN."""
    if runs == 0:
        return Estimate(nan, nan, nan, 0)
    from scipy.stats import binomtest

    found = binomtest(passed, runs).proportion_ci(confidence, method="wilson")
    return Estimate(passed / runs, float(found.low), float(found.high), runs, confidence)


def most_failures(runs: int, confidence: float = CONFIDENCE) -> float:
    """The largest share of runs that may fail where none of some did, one-sided and exact; about 3 / runs. `runs`: that
    passed, with seeds that were not chosen for it; at least 1."""
    return float(1.0 - (1.0 - confidence) ** (1.0 / runs))


def median(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """The median of the values that are not NaN, and its interval: from the k-th smallest to the k-th largest value.

    The true median is not between them if fewer than k values are on one side of it, which has a binomial chance
    whatever the values are distributed like (H. A. David and H. N. Nagaraja, "Order Statistics", 3rd ed. 2003, 7.1).
    k is the largest number of which the level is at least `confidence`. Fewer than six values have no such k.
    """
    there = np.sort([value for value in values if not isnan(value)])
    runs = len(there)
    if runs == 0:
        return Estimate(nan, nan, nan, 0)
    below, above = (float(there[place]) for place in ((runs - 1) // 2, runs // 2))
    # Two infinite ones of one sign stay what they are, those of two signs are even, and nothing overflows.
    middle = below if below == above else 0.0 if below == -above else 0.5 * below + 0.5 * above
    k, level = _ranks(runs, confidence)
    if k == 0:
        return Estimate(middle, nan, nan, runs)
    return Estimate(middle, float(there[k - 1]), float(there[runs - k]), runs, level)


@cache
def _ranks(runs: int, confidence: float) -> tuple[int, float]:
    """The k of the interval of a median, and its level; 0 and NaN if there is none."""
    from scipy.stats import binom

    # Of B ~ Bin(runs, 1/2) values below the true median, 2 P(B < k) is what the interval may miss.
    k = int(binom.ppf((1.0 - confidence) / 2.0, runs, 0.5))
    while k > 0 and 2.0 * binom.cdf(k - 1, runs, 0.5) > 1.0 - confidence:
        k -= 1
    return (k, float(1.0 - 2.0 * binom.cdf(k - 1, runs, 0.5))) if k else (0, nan)


def levels(estimates: Iterable[Estimate]) -> str:
    """The levels of some intervals as a text, such as `96.9 %` or `95.1 to 96.9 %`; "": none has an interval."""
    found = sorted({f"{100.0 * estimate.level:.3g}" for estimate in estimates if isfinite(estimate.level)}, key=float)
    return f"{found[0]} to {found[-1]} %" if len(found) > 1 else f"{found[0]} %" if found else ""


def compare(first: Sequence[float], second: Sequence[float], confidence: float = CONFIDENCE) -> PairedComparison:
    """Compare two series of the same length, each pair with the same seed; pairs with NaN are left out.

    The sign test asks whether the median difference is 0, as the interval does. (Wilcoxon's test asks whether the
    differences are symmetric about 0: of skewed ones with median 0 it finds one in 22 % of 50 pairs.) If both values
    are infinite, the pair is a tie. With fewer than six pairs that differ no test can find a difference with 95 %
    certainty: there is no p then, and a note.
    """
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if not (isnan(a) or isnan(b))]
    differences = np.array([0.0 if a == b else b - a for a, b in pairs])
    if len(pairs) == 0:
        return PairedComparison(
            Estimate(nan, nan, nan, 0), nan, nan, "there is no pair of runs that both have the number"
        )
    differ = int(np.count_nonzero(differences))
    better = float(np.mean((differences < 0) + 0.5 * (differences == 0)))
    p, note = nan, f"{differ} of {len(pairs)} pairs differ: fewer than {LEAST} cannot show a difference (p < 0.05)"
    if differ >= LEAST:
        from scipy.stats import binomtest

        p, note = float(binomtest(int(np.count_nonzero(differences < 0)), differ).pvalue), ""
    return PairedComparison(median(differences.tolist(), confidence), better, p, note)
