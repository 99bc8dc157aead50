"""Many vehicles as a band with a median, and the few that differ most by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.style import NORMAL, STYLES, THIN

NAMED = 3  # outliers
SMALLEST = 1e-6  # of an error: below it is arithmetic, not control
_BINS = 600
_ALL, _MOST = 0.16, 0.32  # opacity of the band of all vehicles, and of that of most

Series = tuple[Array, Array]  # times [s], values


@dataclass(frozen=True, slots=True)
class Band:
    """The spread of many vehicles in each of some intervals of time; arrays of one length."""

    t: Array  # s
    low: Array  # the least of all samples
    high: Array
    most_low: Array  # 10 % and 90 % of the vehicles, by their means
    most_high: Array
    median: Array
    means: dict[int, Array]  # vehicle -> its mean, NaN where it has none


def spread(series: Mapping[int, Series]) -> Band:
    """The spread of signals of vehicles; short peaks stay within its extremes."""
    times = np.unique(np.concatenate([t[np.isfinite(t)] for t, _ in series.values()]))
    if len(times) > _BINS:
        edges = np.linspace(times[0], times[-1], _BINS + 1)
        middle = (edges[1:] + edges[:-1]) / 2
    else:
        edges, middle = np.append(times, np.inf), times
    low, high = np.full(len(middle), np.inf), np.full(len(middle), -np.inf)
    means: dict[int, Array] = {}
    for i, (t, values) in series.items():
        good = np.isfinite(t) & np.isfinite(values)
        place = np.clip(np.searchsorted(edges, t[good], "right") - 1, 0, len(middle) - 1)
        np.minimum.at(low, place, values[good])
        np.maximum.at(high, place, values[good])
        count = np.bincount(place, minlength=len(middle))
        total = np.bincount(place, values[good], minlength=len(middle))
        means[i] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    known = np.isfinite(low)
    table = np.array(list(means.values()))[:, known]
    most_low, median, most_high = np.nanpercentile(table, (10, 50, 90), axis=0)
    named = {i: mean[known] for i, mean in means.items()}
    return Band(middle[known], low[known], high[known], most_low, most_high, median, named)


def outliers(panels: Sequence[Band], log: bool) -> list[int]:
    """The vehicles that are farthest from the median on average over time and panels, the worst first.

    Args:
        log: the signals are errors on a logarithmic axis: only more than the median counts, by its factor.
    """
    score: dict[int, float] = {}
    for one in panels:
        off = {}
        for i, mean in one.means.items():
            if log:
                away = np.maximum(np.log10(np.maximum(mean, SMALLEST) / np.maximum(one.median, SMALLEST)), 0.0)
            else:
                away = np.abs(mean - one.median)
            known = away[np.isfinite(away)]
            off[i] = float(known.mean()) if len(known) else 0.0
        most = max(off.values(), default=0.0) or 1.0
        for i, value in off.items():
            score[i] = score.get(i, 0.0) + value / most
    return sorted(score, key=lambda i: (-score[i], i))[:NAMED]


def draw_band(ax: Axes, found: Band, colour: str = COLOURS[0], style: Any = "-") -> None:
    """The band of all vehicles, that of most, and the median."""
    ax.fill_between(found.t, found.low, found.high, color=colour, alpha=_ALL, linewidth=0, gid="band-all")
    ax.fill_between(found.t, found.most_low, found.most_high, color=colour, alpha=_MOST, linewidth=0, gid="band-most")
    ax.plot(found.t, found.median, color=colour, linestyle=style, linewidth=NORMAL, gid="median")


def outlier_style(k: int) -> dict[str, Any]:
    """How the `k`-th outlier is drawn."""
    return {"color": COLOURS[k + 1], "linestyle": STYLES[k + 1], "linewidth": THIN}


def band_legend(vehicles: int, named: Sequence[int]) -> list[Artist]:
    """The entries of a legend of one run's band."""
    return [
        Line2D([], [], color=COLOURS[0], linewidth=NORMAL, label=f"median of {vehicles}"),
        Patch(color=COLOURS[0], alpha=_ALL + _MOST, linewidth=0, label="10 to 90 %"),
        Patch(color=COLOURS[0], alpha=_ALL, linewidth=0, label="all"),
        *(Line2D([], [], label=f"UUV {i}", **outlier_style(k)) for k, i in enumerate(named)),
    ]
