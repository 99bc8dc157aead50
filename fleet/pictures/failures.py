"""The times at which checks failed, marked on the axes over time."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from fleet.pictures.runs import Run
from fleet.pictures.style import LABEL_PT

MOST_MARKS = 6
_ROOM = 0.06  # of the axis: what a number needs
COLOUR = "#a4001d"


def draw_failures(axes: Sequence[Axes], runs: Sequence[Run]) -> list[str]:
    """A line across all axes at each moment, numbered above the first; returns what each number stands for."""
    begin, end = axes[0].get_xlim()
    by_time: dict[float, list[str]] = {}
    for run in runs:
        of = f" ({run.label})" if len(runs) > 1 else ""
        for name, at_s in run.failures:
            by_time.setdefault(at_s, []).append(f"{name}{of}")
    shown = [(at_s, names) for at_s, names in sorted(by_time.items()) if begin <= at_s <= end]
    words, rows = [], list[float]()  # of each row of numbers above each other where its last one stands
    for number, (at_s, names) in enumerate(shown[:MOST_MARKS], start=1):
        for ax in axes:
            ax.axvline(at_s, color=COLOUR, linewidth=0.9, linestyle=(0, (1, 1)), zorder=4, gid="failed-check")
        row = next((k for k, last in enumerate(rows) if at_s - last > _ROOM * (end - begin)), len(rows))
        rows[row : row + 1] = [at_s]
        axes[0].annotate(
            f"✗{number}", (at_s, 0.0), xycoords=("data", "axes fraction"), textcoords="offset points",
            xytext=(1.5, 2 + row * (LABEL_PT + 2)), color=COLOUR, fontsize=LABEL_PT, ha="left", va="bottom", zorder=5,
            gid="failed-check-name", bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.3},
        )  # fmt: skip
        words.append(f"✗{number}  fails at {at_s:g} s: {', '.join(names)}")
    return words + ([f"and at {len(shown) - MOST_MARKS} more times"] if len(shown) > MOST_MARKS else [])
