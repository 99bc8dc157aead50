"""A signal that oscillates faster than a picture can show: its envelope and its mean instead of a solid block."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fleet.logs.records import Array
from fleet.pictures.bands import SMALLEST, Series

COLUMNS = 90  # of an axis, each about 2 pt wide: two lines beside each other cover it
_TURNS = 2  # in a column: a whole oscillation
_NEAR = 5  # columns; where most of so many have such turns, the signal oscillates and does not only jump
_LEAST = 0.03  # of the range of the axis: what a column's range must be, so that small noise stays a line


class Envelope(NamedTuple):
    """Where a signal oscillates too fast to be seen, and what is drawn instead; arrays of one length."""

    t: Array  # edges of columns [s], each twice, NaN where it does not oscillate
    low: Array
    high: Array


def reach(lines: Iterable[Series], log: bool = False) -> float:
    """The range of all lines of an axis, in decades if it is logarithmic."""
    each = [_seen(values[np.isfinite(values)], log) for _, values in lines]
    some = [values for values in each if len(values)]
    return float(max(values.max() for values in some) - min(values.min() for values in some)) if some else 0.0


def enveloped(
    t: Array, values: Array, span: tuple[float, float], whole: float, log: bool = False
) -> tuple[Series, Envelope | None]:
    """What to draw of a signal.

    Args:
        t: times [s], ascending; NaN in gaps.
        values: of the same length.
        span: the time axis [s].
        whole: the `reach` of all lines of the axis.
        log: its axis is logarithmic.

    Returns:
        The line, which is the mean where the signal oscillates too fast, and the envelope there; None: it never does.
    """
    if len(t) < _TURNS * 2:
        return (t, values), None
    good = np.flatnonzero(np.isfinite(t) & np.isfinite(values) & (t >= span[0]) & (t <= span[1]))
    if len(good) <= COLUMNS * _TURNS:
        return (t, values), None
    edges = np.linspace(*span, COLUMNS + 1)
    place = np.clip(np.searchsorted(edges, t[good], "right") - 1, 0, COLUMNS - 1)
    seen = _seen(values[good], log)
    low, high = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    np.minimum.at(low, place, seen)
    np.maximum.at(high, place, seen)
    steps = np.diff(seen)
    moving = np.flatnonzero(steps)
    turning = moving[1:][np.sign(steps[moving[1:]]) != np.sign(steps[moving[:-1]])]
    turns = np.bincount(place[turning], minlength=COLUMNS)
    fast = (turns >= _TURNS) & (high - low >= _LEAST * whole) & (whole > 0.0)
    fast = (np.convolve(fast, np.ones(_NEAR), "same") > _NEAR / 2) & np.isfinite(low)
    if not fast.any():
        return (t, values), None
    count = np.maximum(np.bincount(place, minlength=COLUMNS), 1)
    mean = np.bincount(place, values[good], minlength=COLUMNS) / count
    of_fast = np.zeros(len(t), bool)
    of_fast[good[fast[place]]] = True
    middle = (edges[1:] + edges[:-1])[fast] / 2
    # Where its samples were in the order of the line, so that gaps stay gaps.
    first = np.searchsorted(place, np.flatnonzero(fast))
    kept = ~of_fast
    order = np.argsort(np.concatenate([np.flatnonzero(kept), good[first]]), kind="stable")
    line = np.concatenate([t[kept], middle])[order], np.concatenate([values[kept], mean[fast]])[order]
    bottom, top = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    np.minimum.at(bottom, place, values[good])
    np.maximum.at(top, place, values[good])
    shape = [np.repeat(np.where(fast, one, np.nan), 2) for one in (bottom, top)]
    return line, Envelope(np.repeat(edges, 2)[1:-1], *shape)


def _seen(values: Array, log: bool) -> Array:
    """Values as the axis shows them."""
    return np.log10(np.maximum(np.abs(values), SMALLEST)) if log else values
