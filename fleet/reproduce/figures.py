"""The paper's figures from our runs: one picture each, undisturbed and disturbed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fleet.plotting import legend, limit, line, panels, save
from fleet.reproduce.cases import NAMES, D, Outcome, U

Outcomes = Mapping[str, Outcome]

TAU_MAX = (20.0, 20.0, 20.0)
RHO_LO, RHO_HI = (0.1, -1.0, -1.25), (1.5, 1.0, 1.25)
START_S = 25.0  # undisturbed, everything has happened by then


def _window(sea: str) -> tuple[float, float]:
    return (0.0, START_S) if sea == U else (0.0, 60.0)


def consensus_errors(o: Outcomes, sea: str) -> Figure:
    """|e_i| of each vehicle under the five controllers."""
    return _by_vehicle(o, sea, "e", "consensus error |e| [m]")


def velocity_errors(o: Outcomes, sea: str) -> Figure:
    """z_i of each vehicle under the five controllers."""
    return _by_vehicle(o, sea, "z", "z [m/s, rad/s]")


def _by_vehicle(o: Outcomes, sea: str, key: str, label: str) -> Figure:
    figure, axes = panels(2, 2)
    for i, ax in enumerate(axes):
        for number, name in enumerate(NAMES):
            outcome = o[f"{name}-{sea}"]
            values = np.linalg.norm(outcome.signals[key][:, i], axis=1)
            line(ax, number, outcome.t, values, name)
        ax.set_title(f"UUV {i + 1}")
        ax.set_xlim(*_window(sea))
        ax.set_yscale("log")
        ax.set_ylim(1e-3, None)
        if i % 2 == 0:
            ax.set_ylabel(label)
        if i >= 2:
            ax.set_xlabel("time [s]")
    legend(figure, axes[0], len(NAMES))
    return figure


def inputs(o: Outcomes, sea: str) -> Figure:
    """The control inputs of UUV 1, and where the actuators saturate."""
    figure, axes = panels(3, 1)
    for k, (ax, label) in enumerate(
        zip(axes, ("surge force [N]", "pitch moment [N m]", "yaw moment [N m]"), strict=True)
    ):
        for number, name in enumerate(NAMES):
            outcome = o[f"{name}-{sea}"]
            line(ax, number, outcome.t, outcome.signals["tau"][:, 0, k], name)
        for bound in (TAU_MAX[k], -TAU_MAX[k]):
            limit(ax, bound, "actuator limit" if bound > 0 else None)
        ax.set_ylabel(label)
        ax.set_xlim(0.0, 10.0 if sea == U else 30.0)
    axes[-1].set_xlabel("time [s]")
    legend(figure, axes[0], len(NAMES) + 1)
    return figure


def commands(o: Outcomes, sea: str) -> Figure:
    """The velocity commands of UUV 1 with the bounds that the optimisation keeps."""
    figure, axes = panels(2, 2)
    labels = ("rho north [m/s]", "rho east [m/s]", "rho down [m/s]", "commanded speed [m/s]")
    for k, (ax, label) in enumerate(zip(axes, labels, strict=True)):
        for number, name in enumerate(NAMES):
            outcome = o[f"{name}-{sea}"]
            values = outcome.signals["rho"][:, 0, k] if k < 3 else outcome.signals["u_cmd"][:, 0, 0]
            line(ax, number, outcome.t, values, name)
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
        for i in range(4):
            line(ax, i, outcome.t, outcome.signals["K"][:, i, k], f"UUV {i + 1}")
        ax.set_ylabel(f"K {name} [1/s]")
        ax.set_xlim(*_window(sea))
    axes[-1].set_xlabel("time [s]")
    legend(figure, axes[0], 4)
    return figure


def readings(o: Outcomes, sea: str) -> Figure:
    """NBOC with the printed and the corrected cost, and over a network, against NBC."""
    figure, axes = panels(2, 2)
    shown = (
        (f"NBOC-{sea}", "NBOC, printed cost"),
        (f"NBOC-consistent-{sea}", "NBOC, corrected cost"),
        (f"NBOC-network-{sea}", "NBOC, network of 10 ms"),
        (f"NBC-{sea}", "NBC"),
    )
    for i, ax in enumerate(axes):
        for number, (name, label) in enumerate(shown):
            outcome = o[name]
            line(ax, number, outcome.t, np.linalg.norm(outcome.signals["e"][:, i], axis=1), label)
        ax.set_title(f"UUV {i + 1}")
        ax.set_xlim(*_window(sea))
        ax.set_yscale("log")
        ax.set_ylim(1e-3, None)
        if i % 2 == 0:
            ax.set_ylabel("consensus error |e| [m]")
        if i >= 2:
            ax.set_xlabel("time [s]")
    legend(figure, axes[0], len(shown))
    return figure


# File name -> (what it shows, of which sea, how).
FIGURES: dict[str, tuple[str, str, Callable[[Outcomes, str], Figure]]] = {
    "fig3-consensus-errors-undisturbed": ("Fig. 3: consensus errors, undisturbed", U, consensus_errors),
    "fig4-velocity-errors-undisturbed": ("Fig. 4: velocity tracking errors z, undisturbed", U, velocity_errors),
    "fig5-inputs-undisturbed": ("Fig. 5: control inputs of UUV 1, undisturbed", U, inputs),
    "fig6-commands-undisturbed": ("Fig. 6: velocity commands of UUV 1 and their bounds, undisturbed", U, commands),
    "fig7-gains-undisturbed": ("Fig. 7: gains of NBOC, undisturbed", U, gains),
    "fig8-consensus-errors-disturbed": ("Fig. 8: consensus errors, disturbed", D, consensus_errors),
    "fig9-velocity-errors-disturbed": ("Fig. 9: velocity tracking errors z, disturbed", D, velocity_errors),
    "fig10-gains-disturbed": ("Fig. 10: gains of NBOC, disturbed", D, gains),
    "inputs-disturbed": ("Control inputs of UUV 1, disturbed", D, inputs),
    "commands-disturbed": ("Velocity commands of UUV 1 and their bounds, disturbed", D, commands),
    "readings-undisturbed": ("The readings side by side, undisturbed", U, readings),
    "readings-disturbed": ("The readings side by side, disturbed", D, readings),
}


def draw(name: str, outcomes: Outcomes, folder: Path, formats: tuple[str, ...]) -> bool:
    """Draw one picture; False if one of its runs was left out."""
    _, sea, make = FIGURES[name]
    try:
        figure = make(outcomes, sea)
    except KeyError:
        return False
    save(figure, folder / name, formats)
    return True
