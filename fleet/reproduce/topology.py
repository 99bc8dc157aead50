"""The paper's Fig. 2: the graph over which the consensus runs, from the scenario."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fleet.palette import COLOURS
from fleet.pictures.style import LABEL_PT, LEGEND_PT, TEXT_PT, panels
from fleet.reproduce.cases import CASES, Outcome

Point = tuple[float, float]

REFERENCE_Y = 0.75  # of the reference's bar, above the row of vehicles
RADIUS_PT = 13  # of a vehicle's circle


def topology(outcomes: Mapping[str, Outcome], sea: str) -> Figure:
    """The vehicles in a row with the weights a_ij of what i hears from j, and b_i of what it knows of the reference."""
    scenario = CASES[outcomes[f"NBOC-{sea}"].name].scenario()
    figure, (ax,) = panels(1, 1, height=2.0)
    n = scenario.vehicles
    places: dict[int, Point] = {i: (float(i), 0.0) for i in range(1, n + 1)}
    for i, (x, y) in places.items():
        for j, a in scenario.graph.neighbours(i):
            _arrow(ax, places[j], (x, y), f"a$_{{{i}{j}}}$ = {a:g}", bend=0.3)
        if b := scenario.b[i - 1]:
            _arrow(ax, (x, REFERENCE_Y), (x, y), f"b$_{i}$ = {b:g}", colour=COLOURS[1])
        ax.plot([x], [y], "o", markersize=2 * RADIUS_PT, color="white", markeredgecolor="black", zorder=3)
        ax.text(x, y, f"UUV {i}", ha="center", va="center", zorder=4, fontsize=LABEL_PT)
    ax.plot([0.8, n + 0.2], [REFERENCE_Y] * 2, color=COLOURS[1], linewidth=16, solid_capstyle="round")
    words = "reference $\\eta_1^d$, its velocity known to all"
    ax.text((1 + n) / 2, REFERENCE_Y, words, ha="center", va="center", color="white", fontsize=TEXT_PT, zorder=4)
    ax.set_xlim(0.6, n + 0.4)
    ax.set_ylim(-0.4, REFERENCE_Y + 0.15)
    ax.axis("off")
    return figure


def _arrow(ax: Axes, source: Point, target: Point, text: str, bend: float = 0.0, colour: str = COLOURS[0]) -> None:
    """An arrow from one place to another, bent to the left of its direction, with a text beside its middle."""
    style = {
        "arrowstyle": "-|>",
        "color": colour,
        "connectionstyle": f"arc3,rad={-bend}",
        "shrinkA": RADIUS_PT + 1,
        "shrinkB": RADIUS_PT + 1,
    }
    ax.annotate("", target, source, arrowprops=style)
    (x1, y1), (x2, y2) = source, target
    x, y = (x1 + x2) / 2, (y1 + y2) / 2
    ax.text(x, y + 0.85 * bend * (x2 - x1), text, ha="center", va="center", color=colour, fontsize=LEGEND_PT,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
