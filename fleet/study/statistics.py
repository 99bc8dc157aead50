"""How sure a study is: intervals of pass rates and medians, and two series over the same seeds compared in pairs.

Packets' fates are hashed draws of seed, link and number: runs with the same seed meet the same network, whatever their
controller. So two controllers are compared seed by seed, which needs far fewer runs than two independent series.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, inf, isfinite, isnan, nan
from typing import NamedTuple

import numpy as np

CONFIDENCE = 0.95
_RESAMPLES = 2000
_MOST_BCA = 1000
_HUGE = 1e300  # stands for infinity while medians are computed
_SEED = 1  # of the bootstrap, so that a table reads the same each time


class Estimate(NamedTuple):
    """A number of several runs and its interval; NaN where there are too few."""

    value: float  # inf: half of the runs or more have none, and that counts as larger than every number
    low: float
    high: float
    runs: int  # behind it, those with inf included

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2


class Comparison(NamedTuple):
    """A second series against a first one, run by run with the same seed."""

    difference: Estimate  # the median of second - first
    better: float  # share of pairs in which the second is smaller, ties by half; 0.5: no difference
    p: float  # of the two-sided Wilcoxon signed-rank test; NaN: too few pairs that differ


def pass_rate(passed: int, runs: int, confidence: float = CONFIDENCE) -> Estimate:
    """The share of runs that passed, with its Wilson score interval.

    Args:
        runs: with a verdict; 0 gives NaN.
    """
    if runs == 0:
        return Estimate(nan, nan, nan, 0)
    from scipy.stats import binomtest

    found = binomtest(passed, runs).proportion_ci(confidence, method="wilson")
    return Estimate(passed / runs, float(found.low), float(found.high), runs)


def most_failures(runs: int, confidence: float = CONFIDENCE) -> float:
    """The largest share of runs that may fail where none of some did, one-sided and exact; about 3 / runs.

    Args:
        runs: that passed, with seeds that were not chosen for it; at least 1.
    """
    return float(1.0 - (1.0 - confidence) ** (1.0 / runs))


def median(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """The median of the values that are not NaN, with its bootstrapped interval: BCa, or percentile where BCa is not
    defined (one of them is infinite, or nearly all are the same), or there are more than 1000 values."""
    there = np.array([value for value in values if not isnan(value)])
    if len(there) == 0:
        return Estimate(nan, nan, nan, 0)
    bounded = bool(np.isfinite(there).all())
    finite = np.clip(there, -_HUGE, _HUGE)
    middle = _unbounded(float(np.median(finite)))
    if len(finite) < 3:
        return Estimate(middle, nan, nan, len(finite))
    if np.ptp(finite) == 0.0:
        return Estimate(middle, middle, middle, len(finite))
    import warnings

    from scipy.stats import bootstrap

    found = None
    # BCa leaves out each value once, which takes the square of their number in memory.
    for method in ("BCa", "percentile") if bounded and len(finite) <= _MOST_BCA else ("percentile",):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # BCa is not defined for such data: its interval is NaN then
            found = bootstrap(
                (finite,), np.median, confidence_level=confidence, n_resamples=_RESAMPLES, method=method,
                vectorized=True, axis=-1, batch=100, rng=np.random.default_rng(_SEED),
            ).confidence_interval  # fmt: skip
        if isfinite(found.low) and isfinite(found.high):
            break
    assert found is not None
    # An end is interpolated between two resamples, which may put it a last bit on the wrong side of the median.
    low, high = min(_unbounded(float(found.low)), middle), max(_unbounded(float(found.high)), middle)
    return Estimate(middle, low, high, len(finite))


def _unbounded(value: float) -> float:
    """An infinite number again: one that is no less than half of what stands for infinity."""
    return value if abs(value) < _HUGE / 3 else copysign(inf, value)


def compare(first: Sequence[float], second: Sequence[float], confidence: float = CONFIDENCE) -> Comparison:
    """Compare two series of the same length, each pair with the same seed; pairs with NaN are left out.

    What is infinite in both is a tie; in one, the largest of differences.
    """
    pairs = [(a, b) for a, b in zip(first, second, strict=True) if not (isnan(a) or isnan(b))]
    differences = np.array([0.0 if a == b else b - a for a, b in pairs])
    if len(pairs) == 0:
        return Comparison(Estimate(nan, nan, nan, 0), nan, nan)
    better = float(np.mean((differences < 0) + 0.5 * (differences == 0)))
    p = nan
    if np.count_nonzero(differences) >= 5:
        from scipy.stats import wilcoxon

        p = float(wilcoxon(np.clip(differences, -_HUGE, _HUGE)).pvalue)
    return Comparison(median(differences.tolist(), confidence), better, p)
