"""A histogram of durations in logarithmic buckets, so that memory stays small and percentiles have a relative error.

The buckets are those of DDSketch (C. Masson, J. E. Rim, H. K. Lee, "DDSketch: a fast and fully-mergeable quantile
sketch with relative-error guarantees", VLDB 2019): each ends a fixed factor after the one before.
"""

from __future__ import annotations

from collections import Counter
from math import floor, log10
from typing import Any

PER_DECADE = 20  # buckets, so a percentile is at most 12 % too high
LEAST_NS = 1_000  # everything below counts as this


class Histogram:
    """A histogram of durations [ns] on a logarithmic scale; negative ones are counted apart from it."""

    def __init__(self) -> None:
        self.count = 0
        self.negative = 0
        self.most_ns = 0
        self._buckets: Counter[int] = Counter()

    def add(self, ns: int) -> None:
        self.count += 1
        if ns < 0:
            self.negative += 1
            return
        self.most_ns = max(self.most_ns, ns)
        self._buckets[0 if ns <= LEAST_NS else 1 + floor(PER_DECADE * log10(ns / LEAST_NS))] += 1

    def percentile_ns(self, percent: float) -> int:
        """The smallest end of a bucket that at least this percentage did not exceed; 0 if the histogram is empty."""
        rank = self.count * percent / 100
        seen = self.negative
        if seen >= rank:
            return 0
        for bucket in sorted(self._buckets):
            seen += self._buckets[bucket]
            if seen >= rank:
                return min(self.most_ns, _end_ns(bucket))
        return self.most_ns

    def to_values(self) -> dict[str, Any]:
        """Percentiles, and the histogram as [upper edge in ms, count] of every bucket that is not empty."""
        return {
            "count": self.count,
            "negative": self.negative,
            **{f"p{p}_ms": self.percentile_ns(p) / 1e6 for p in (50, 95, 99)},
            "max_ms": self.most_ns / 1e6,
            "histogram_ms": [[round(_end_ns(b) / 1e6, 6), self._buckets[b]] for b in sorted(self._buckets)],
        }


def _end_ns(bucket: int) -> int:
    return LEAST_NS if bucket == 0 else round(LEAST_NS * 10 ** (bucket / PER_DECADE))
