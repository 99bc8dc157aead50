"""Where the vehicles believed that they were, beside where they were: a thin way, and an ellipse at a few moments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleet.logs.records import Array
from fleet.pictures.runs import Run, View
from fleet.scene.belief import ellipse
from fleet.scene.primitives import LineShape

MOMENTS = 5


class BelievedWay(NamedTuple):
    """What one vehicle believed."""

    positions: Array  # (samples, 3) [m, NED]
    ellipses: list[LineShape]


def believed_way(run: Run, i: int, view: View) -> BelievedWay | None:
    """What vehicle i believed in the window of a picture; None: it knew where it was, or the log does not say."""
    belief, state = f"uuv/{i}/belief", f"uuv/{i}/state"
    if any(topic not in run.log or not len(run.log[topic]) for topic in (belief, state)):
        return None
    known, true = run.log[belief], run.log[state]
    if any(name not in known for name in ("off", "covariance")):
        return None
    t, off, covariance = known.t, known["off"], known["covariance"]
    if off.shape != (len(t), 3) or covariance.shape != (len(t), 10):
        return None  # of another log
    first, last = view.window or (0.0, run.log.end)
    inside = (t >= first) & (t <= last)
    if not inside.any():
        return None
    t, off, covariance = t[inside], off[inside], covariance[inside]
    positions = np.column_stack([np.interp(t, true.t, true[name]) for name in ("x", "y", "z")]) + off
    moments = [min(int(np.searchsorted(t, at)), len(t) - 1) for at in np.linspace(first, last, MOMENTS)]
    ellipses = [ellipse(i, positions[k].tolist(), covariance[k].tolist()) for k in dict.fromkeys(moments)]
    return BelievedWay(positions, [one for one in ellipses if one is not None])
