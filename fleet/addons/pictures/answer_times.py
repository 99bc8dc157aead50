"""How punctual a run on a wall clock was: how late each agent answered, and what a packet's delay became."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fleet.addons.pictures.axes import (
    MOST_NAMED,
    legend_of,
)
from fleet.addons.pictures.look import column_in, label_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View
from fleet.addons.pictures.style import STYLES, THIN, panels
from fleet.logs.schemas import CLOCK
from fleet.palette import COLOURS
from fleet.result.file import ResultError, read_result
from fleet.result.timing import Spread, Timing
from netem.clock import Clock

GREY = "#999999"


def punctuality(runs: Sequence[LoggedRun], view: View) -> Figure:
    """Above, what share of each agent's answers took longer than so long; below, of deliveries."""
    (run,) = runs
    timing = _timing(run)
    figure, (top, bottom) = panels(2, 1, column_in(), 3.9)
    rows = {i: timing.vehicles[str(i)] for i in run.vehicles(view)}
    worst = sorted(rows, key=lambda i: -rows[i].response.p99_ms)[: MOST_NAMED - 1]
    for i, row in rows.items():
        k = sorted(worst).index(i) if i in worst else -1
        colour, style = (COLOURS[k], STYLES[k]) if k >= 0 else (GREY, "-")
        _tail(top, row.response.histogram_ms, row.response.negative, colour, style)
    top.axvline(timing.world.period_ms, color="#000000", linewidth=THIN, linestyle=(0, (1, 1)))
    top.set_ylabel("share of answers slower")
    links = timing.netem.links.values()
    shown: list[tuple[str, str, Any, list[tuple[float, int]]]] = [
        ("injected, sim time", COLOURS[4], "-", _sum(link.injected for link in links)),
        ("measured, sim time", COLOURS[6], "--", _sum(link.measured for link in links)),
        ("network to agent, wall time", COLOURS[5], "-.", timing.netem.hop.histogram_ms),
    ]
    for _, colour, style, histogram in shown:
        _tail(bottom, histogram, 0, colour, style)
    bottom.set_ylabel("share of packets slower")
    for ax in (top, bottom):
        ax.set_xscale("log")
        ax.set_yscale("log")
    top.tick_params(labelbottom=True)
    top.annotate(" a tick", (timing.world.period_ms, 0.03), xycoords=("data", "axes fraction"), fontsize=label_pt())
    top.set_xlabel("answer after its tick began [ms of wall time]")
    bottom.set_xlabel("delay [ms]")
    more = [("others", GREY, "-")] if len(rows) > len(worst) else []
    vehicles = [(f"UUV {i}", COLOURS[k], STYLES[k]) for k, i in enumerate(sorted(worst))]
    legend_of(figure, [*vehicles, *more, *((name, colour, style) for name, colour, style, _ in shown)])
    return figure


def has_wall_clock(run: LoggedRun) -> bool:
    """Whether anything could be late in it."""
    return run.log.run.get(CLOCK) == Clock.REAL


def _timing(run: LoggedRun) -> Timing:
    if not has_wall_clock(run):
        raise NothingToDraw("the run was in lockstep, where nothing can be late; see fleet run --clock real")
    try:
        timing = read_result(run.log.path.parent).timing
    except FileNotFoundError as error:
        raise NothingToDraw(f"{error.filename} is not there: the run did not end by itself") from None
    except ResultError as error:
        raise NothingToDraw(str(error)) from None
    if timing is None:
        raise NothingToDraw("the result.json beside the log has no timing")
    if missing := [i for i in run.log.vehicles if str(i) not in timing.vehicles]:
        raise NothingToDraw(f"the result.json beside the log has no timing of vehicle {missing[0]}")
    return timing


def _sum(spreads: Iterable[Spread]) -> list[tuple[float, int]]:
    total: Counter[float] = Counter()
    for spread in spreads:
        for edge, count in spread.histogram_ms:
            total[edge] += count
    return [(edge, total[edge]) for edge in sorted(total)]


def _tail(ax: Axes, histogram: list[tuple[float, int]], below: int, colour: str, style: Any) -> None:
    """The share that took longer than each edge of a histogram; `below` lie under its first."""
    if not histogram:
        return
    edges, counts = (np.array(column, float) for column in zip(*histogram, strict=True))
    total = counts.sum() + below
    slower = 1.0 - (below + np.cumsum(counts)) / total
    # The last bin is reached by no sample: the line ends at the smallest share.
    t = np.concatenate(([edges[0] / 1.12], edges))
    share = np.concatenate(([1.0], np.maximum(slower, 0.5 / total)))
    ax.plot(t, share, color=colour, linestyle=style, drawstyle="steps-post")
