"""Where the vehicles believed that they were, beside where they were: a thin way, and an ellipse at a few moments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from fleet.logs.records import Array
from fleet.pictures.beliefs import beliefs
from fleet.pictures.runs import Run, View
from fleet.scene.belief import ellipse
from fleet.scene.primitives import AreaShape

MOMENTS = 5
STRETCHES = 40  # of a way in three dimensions
_LINE: dict[str, Any] = {"linewidth": 0.6, "linestyle": (0, (2, 1))}
_AREA: dict[str, Any] = {"alpha": 0.2, "linewidth": 0.5, "zorder": 1.5}
BELIEF_ENTRIES: list[Artist] = [  # of a legend
    Line2D([], [], label="as believed", **_LINE, color="0.3"),
    Patch(label="95 % ellipse", color="0.3", alpha=_AREA["alpha"]),
]


class BelievedWay(NamedTuple):
    """The beliefs of one vehicle."""

    vehicle: int
    colour: str
    positions: Array  # (samples, 3) [m, NED]
    ellipses: list[AreaShape]


def believed_way(run: Run, i: int, colour: str, view: View) -> BelievedWay | None:
    """The beliefs of vehicle i in the window of a picture; None: it knew where it was, or the log has no beliefs."""
    known, state = beliefs(run.log, i), f"uuv/{i}/state"
    if known is None or state not in run.log or not len(run.log[state]):
        return None
    true, (first, last) = run.log[state], view.window or (0.0, run.log.end)
    inside = np.flatnonzero((known.t >= first) & (known.t <= last))
    if not len(inside):
        return None
    t = known.t[inside]
    positions = np.column_stack([np.interp(t, true.t, true[name]) for name in ("x", "y", "z")]) + known.off[inside]
    moments = [min(int(np.searchsorted(t, at)), len(t) - 1) for at in np.linspace(first, last, MOMENTS)]
    ellipses = [ellipse(i, positions[k].tolist(), known.covariance[inside[k]].tolist()) for k in dict.fromkeys(moments)]
    return BelievedWay(i, colour, positions, [one for one in ellipses if one is not None])


def draw_ways(ax: Axes, ways: Sequence[BelievedWay]) -> None:
    """Draw them from above."""
    for way in ways:
        p, gid = way.positions, f"belief-{way.vehicle}"
        ax.plot(p[:, 1], p[:, 0], color=way.colour, zorder=2.2, gid=gid, **_LINE)
        for one in way.ellipses:
            norths, easts = [point.north for point in one.points], [point.east for point in one.points]
            ax.fill(easts, norths, color=way.colour, gid=f"ellipse-{way.vehicle}", **_AREA)


def draw_ways_in_space(ax: Any, ways: Sequence[BelievedWay]) -> None:
    """Draw them in three dimensions; an ellipse lies at the depth that the vehicle believes.

    Depth is exaggerated, so the noise of its sensor would hide everything: the line joins means of short stretches.
    """
    for way in ways:
        p = np.array([part.mean(axis=0) for part in np.array_split(way.positions, STRETCHES) if len(part)])
        ax.plot(p[:, 1], p[:, 0], p[:, 2], color=way.colour, gid=f"belief-{way.vehicle}", **_LINE)
        for one in way.ellipses:
            corners = [[(point.east, point.north, point.down) for point in one.points]]
            style = {"facecolor": way.colour, "edgecolor": way.colour, "gid": f"ellipse-{way.vehicle}"}
            ax.add_collection3d(Poly3DCollection(corners, **style, **_AREA))
