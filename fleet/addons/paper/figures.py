"""The paper's figures from our runs: one picture each, undisturbed and disturbed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fleet.addons.paper.cases import CASES, NAMES, D, Outcome, U
from fleet.addons.pictures.look import LABEL_PT, LEGEND_PT, TEXT_PT
from fleet.addons.pictures.style import HEAVY, NORMAL, THIN, Provenance, legend, limit, panels, save
from fleet.palette import COLOURS

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


Outcomes = Mapping[str, Outcome]

TAU_MAX = (20.0, 20.0, 20.0)
RHO_LO, RHO_HI = (0.1, -1.0, -1.25), (1.5, 1.0, 1.25)
START_S, FAST_S = 25.0, 12.0  # undisturbed, everything has happened by then, to e and to z
MINUTE_S = 60.0
DEMANDED_S = 1.5  # in which the demand is far beyond the limit
SEEN = 250  # samples of the last two periods

# How a line is drawn. Lines that lie on each other for most of the time differ in width: pale and wide below, thin
# and dashed above, so that each can be seen.
LineStyle = dict[str, Any]
WIDE: LineStyle = {"linewidth": HEAVY, "alpha": 0.4, "zorder": 2.0}
PLAIN: LineStyle = {"linewidth": NORMAL, "zorder": 2.1}
DASHED: LineStyle = {"linewidth": THIN, "linestyle": (0, (3, 2.5)), "zorder": 2.2}
OF_CONTROLLERS = dict(zip(NAMES, (WIDE, DASHED, PLAIN, WIDE, DASHED), strict=True))  # NBC lies near BC and BSMC
OF_VEHICLES = (WIDE, WIDE, DASHED, DASHED)  # 1 lies near 4, and 2 near 3


class Line(NamedTuple):
    case: str
    label: str
    colour: str
    style: LineStyle

    def draw(self, ax: Axes, t: Any, values: Any) -> None:
        ax.plot(t, values, color=self.colour, label=self.label, **self.style)


def _controllers(sea: str) -> list[Line]:
    return [Line(f"{name}-{sea}", name, COLOURS[number], OF_CONTROLLERS[name]) for number, name in enumerate(NAMES)]


def errors(o: Outcomes, sea: str, key: str, label: str, until_s: float) -> Figure:
    """|e_i| or z_i of each vehicle under the five controllers."""
    return _figure_by_vehicle(o, _controllers(sea), key, label, until_s) if sea == U else _periods(o, sea, key, label)


consensus_errors = partial(errors, key="e", label="consensus error |e| [m]", until_s=START_S)
velocity_errors = partial(errors, key="z", label="z [m/s, rad/s]", until_s=FAST_S)


def readings(o: Outcomes, sea: str) -> Figure:
    """NBOC with the printed and the corrected cost, and over a network, against NBC."""
    shown = [
        Line(f"NBOC-{sea}", "NBOC, printed cost", COLOURS[0], WIDE),
        Line(f"NBOC-network-{sea}", "the same, network of 10 ms", COLOURS[4], DASHED),
        Line(f"NBOC-consistent-{sea}", "NBOC, corrected cost", COLOURS[3], PLAIN),
        Line(f"NBC-{sea}", "NBC", COLOURS[2], PLAIN),
    ]
    return _figure_by_vehicle(o, shown, "e", "consensus error |e| [m]", START_S)


def _figure_by_vehicle(o: Outcomes, shown: Sequence[Line], key: str, label: str, until_s: float) -> Figure:
    figure, axes = panels(2, 2)
    for i, ax in enumerate(axes):
        _norms(ax, o, shown, key, i)
        ax.set_title(f"UUV {i + 1}")
        ax.set_xlim(0.0, until_s)
        _decades(ax)
        if i % 2 == 0:
            ax.set_ylabel(label)
        if i >= 2:
            ax.set_xlabel("time [s]")
    legend(figure, axes[0], len(shown))
    return figure


def _periods(o: Outcomes, sea: str, key: str, label: str) -> Figure:
    figure, axes = panels(4, 2, share="col", height=7.2)
    shown = _controllers(sea)
    end_s = float(o[shown[0].case].t[-1])
    for place, ax in enumerate(axes):
        _norms(ax, o, shown, key, place // 2)
        if place % 2 == 0:
            ax.set_xlim(0.0, START_S)
            _decades(ax)
            ax.set_ylabel(f"UUV {place // 2 + 1}\n{label}")
        else:
            ax.set_xlim(end_s - 4.0 * pi, end_s)
            late = [np.linalg.norm(o[of.case].signals[key][:, place // 2], axis=1)[-SEEN:] for of in shown]
            ax.set_ylim(0.0, 1.1 * max(float(np.nanmax(values)) for values in late))
    axes[0].set_title("the start")
    axes[1].set_title("the last two periods, linear")
    for ax in axes[-2:]:
        ax.set_xlabel("time [s]")
    legend(figure, axes[0], len(shown))
    return figure


def _norms(ax: Axes, o: Outcomes, shown: Sequence[Line], key: str, i: int) -> None:
    for of in shown:
        of.draw(ax, o[of.case].t, np.linalg.norm(o[of.case].signals[key][:, i], axis=1))


def _decades(ax: Axes) -> None:
    ax.set_yscale("log")
    ax.set_ylim(1e-3, 20.0)


def inputs(o: Outcomes, sea: str) -> Figure:
    """The control inputs of UUV 1 as they are demanded, beside what the actuators can: at once, and then."""
    figure, axes = panels(3, 2, share="col", height=5.6)
    labels = ("surge force [N]", "pitch moment [N m]", "yaw moment [N m]")
    for place, ax in enumerate(axes):
        k, at_once = place // 2, place % 2 == 0
        for of in _controllers(sea):
            signals = o[of.case].inputs
            of.draw(ax, signals["t"], signals["demand"][:, k])
        for bound in (TAU_MAX[k], -TAU_MAX[k]):
            limit(ax, bound, "actuator limit" if bound > 0 else None)
        if at_once:
            ax.set_ylabel(f"demanded\n{labels[k]}")
            ax.set_xlim(0.0, DEMANDED_S)
        else:
            ax.set_xlim(DEMANDED_S, 10.0 if sea == U else 30.0)
            ax.set_ylim(-1.3 * TAU_MAX[k], 1.3 * TAU_MAX[k])
    for ax in axes[-2:]:
        ax.set_xlabel("time [s]")
    axes[0].set_title(f"the first {DEMANDED_S:g} s")
    axes[1].set_title("afterwards")
    legend(figure, axes[0], len(NAMES) + 1)
    return figure


def commands(o: Outcomes, sea: str) -> Figure:
    """The velocity commands of UUV 1 with the bounds that the optimisation keeps."""
    figure, axes = panels(2, 2)
    labels = ("rho north [m/s]", "rho east [m/s]", "rho down [m/s]", "commanded speed [m/s]")
    for k, (ax, label) in enumerate(zip(axes, labels, strict=True)):
        for of in _controllers(sea):
            signals = o[of.case].signals
            of.draw(ax, o[of.case].t, signals["rho"][:, 0, k] if k < 3 else signals["u_cmd"][:, 0, 0])
        if k < 3:
            limit(ax, RHO_LO[k], "bounds of NBOC, BOC")
            limit(ax, RHO_HI[k])
        ax.set_ylabel(label)
        ax.set_xlim(0.0, 15.0 if sea == U else 30.0)
        if k >= 2:
            ax.set_xlabel("time [s]")
    legend(figure, axes[0], len(NAMES) + 1)
    return figure


def gains(o: Outcomes, sea: str) -> Figure:
    """The gains that NBOC's optimisation chooses, of all vehicles."""
    figure, axes = panels(3, 1)
    outcome = o[f"NBOC-{sea}"]
    for k, (ax, name) in enumerate(zip(axes, ("north", "east", "down"), strict=True)):
        for i, style in enumerate(OF_VEHICLES):
            Line(outcome.name, f"UUV {i + 1}", COLOURS[i], style).draw(ax, outcome.t, outcome.signals["K"][:, i, k])
        ax.set_ylabel(f"K {name} [1/s]")
        ax.set_xlim(0.0, START_S if sea == U else MINUTE_S)
        ax.set_ylim(0.0, None)
    axes[-1].set_xlabel("time [s]")
    legend(figure, axes[0], 4)
    return figure


def bursts(o: Outcomes, sea: str) -> Figure:
    """The result of two minutes with a gain that has no upper bound: UUV 2."""
    figure, axes = panels(3, 1)
    shown = [
        Line(f"NBOC-no-k_max-{sea}", "NBOC, no bound on K", COLOURS[0], PLAIN),
        Line(f"BOC-no-k_max-{sea}", "BOC, no bound on K", COLOURS[1], PLAIN),
        Line(f"NBOC-{sea}", "NBOC", COLOURS[5], WIDE),
        Line(f"NBC-{sea}", "NBC", COLOURS[2], DASHED),
    ]
    for ax, key, label in zip(axes, ("e", "z", "K"), ("|e| [m]", "z [m/s, rad/s]", "K north [1/s]"), strict=True):
        if key == "K":
            for of in shown:
                of.draw(ax, o[of.case].t, o[of.case].signals["K"][:, 1, 0])
        else:
            _norms(ax, o, shown, key, 1)
        ax.set_ylabel(label)
        ax.set_xlim(20.0, float(o[shown[0].case].t[-1]))
    axes[0].set_ylim(0.0, 0.15)
    _decades(axes[1])
    axes[-1].set_xlabel("time [s]")
    legend(figure, axes[0], len(shown))
    return figure


# File name -> (what it shows, of which sea, how).
FIGURES: dict[str, tuple[str, str, Callable[[Outcomes, str], Figure]]] = {
    "fig2-topology": ("Fig. 2: who hears whom, and who knows the reference", U, topology),
    "fig3-consensus-errors-undisturbed": ("Fig. 3: consensus errors, undisturbed", U, consensus_errors),
    "fig4-velocity-errors-undisturbed": ("Fig. 4: velocity tracking errors z, undisturbed", U, velocity_errors),
    "fig5-inputs-undisturbed": ("Fig. 5: demanded control inputs of UUV 1, undisturbed", U, inputs),
    "fig6-commands-undisturbed": ("Fig. 6: velocity commands of UUV 1 and their bounds, undisturbed", U, commands),
    "fig7-gains-undisturbed": ("Fig. 7: gains of NBOC, undisturbed", U, gains),
    "fig8-consensus-errors-disturbed": ("Fig. 8: consensus errors, disturbed", D, consensus_errors),
    "fig9-velocity-errors-disturbed": ("Fig. 9: velocity tracking errors z, disturbed", D, velocity_errors),
    "fig10-gains-disturbed": ("Fig. 10: gains of NBOC, disturbed", D, gains),
    "inputs-disturbed": ("Demanded control inputs of UUV 1, disturbed", D, inputs),
    "commands-disturbed": ("Velocity commands of UUV 1 and their bounds, disturbed", D, commands),
    "no-bound-on-K-disturbed": ("No bound on K, disturbed: UUV 2 for two minutes", D, bursts),
    "readings-undisturbed": ("The readings side by side, undisturbed", U, readings),
    "readings-disturbed": ("The readings side by side, disturbed", D, readings),
}


def draw(wanted: tuple[str, Outcomes], folder: Path, formats: tuple[str, ...]) -> bool:
    """Draw one picture; False if one of its runs was left out."""
    name, outcomes = wanted
    title, sea, make = FIGURES[name]
    try:
        figure = make(outcomes, sea)
    except KeyError:
        return False
    seeds = {CASES[case].scenario().seed for case in outcomes}
    facts = (("scenario", ", ".join(outcomes)), ("seed", ", ".join(map(str, sorted(seeds)))))  # there are no logs
    save(figure, folder / name, formats, Provenance(title, facts))
    return True
