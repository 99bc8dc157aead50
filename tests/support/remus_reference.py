"""Manoeuvres of a REMUS 100, and how Fossen's Python Vehicle Simulator makes them.

`python tests/support/remus_reference.py` writes `tests/golden/remus100.npz` and the picture of the page
docs/background/plants.md, with `--picture` only the latter. The former needs the package `python_vehicle_simulator` of
github.com/cybergalactic/PythonVehicleSimulator (MIT licence), which cannot be installed by its name.

A row of a run has the columns x, y, z [m], phi, theta, psi [rad], u, v, w [m/s], p, q, r [rad/s], n [rpm], rudder,
stern plane [rad].
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import atan2, cos, degrees, exp, hypot, pi, radians, sin
from typing import Any, NamedTuple

import numpy as np
from repository import GOLDEN, ROOT

from world.api import Water
from world.plants.remus100 import advance

FILE = GOLDEN / "remus100.npz"
EVERY_S = 0.5  # between two rows
STEP_S = 0.001  # of the reference, which integrates by Euler's method
Run = np.ndarray[Any, Any]


class Manoeuvre(NamedTuple):
    """What the actuators are told, and the water."""

    seconds: int
    commands: Callable[[float], tuple[float, float, float]]  # of t [s]: n [rpm], rudder, stern [rad]
    current: float = 0.0  # [m/s]
    towards: float = 0.0  # where the current goes [rad]
    cruising: bool = True  # begins at 1.9 m/s and 1200 rpm; otherwise at rest


def _at(t: float, begin: float, degrees: float) -> float:
    return radians(degrees) if t >= begin else 0.0


MANOEUVRES = {
    "propeller": Manoeuvre(60, lambda t: (1525.0, 0.0, 0.0), cruising=False),
    "rudder": Manoeuvre(60, lambda t: (1200.0, _at(t, 5.0, 5.0), 0.0)),
    "stern": Manoeuvre(60, lambda t: (1200.0, 0.0, _at(t, 5.0, 5.0))),
    "circle": Manoeuvre(90, lambda t: (1200.0, radians(15.0), 0.0)),
    "dive": Manoeuvre(60, lambda t: (1200.0, 0.0, radians(15.0 if t < 10.0 else -5.0 if t < 20.0 else 0.0))),
    "astern": Manoeuvre(90, lambda t: (1200.0, 0.0, 0.0), 0.5, 0.0),
    "abeam": Manoeuvre(90, lambda t: (1200.0, _at(t, 30.0, 5.0), 0.0), 0.5, 0.5 * pi),
}


# What the runs come to: words, manoeuvre, decimals, and the number in a run.
MEASURES: tuple[tuple[str, str, int, Callable[[Run], float]], ...] = (
    ("propeller step to 1525 rpm: speed after 60 s [m/s]", "propeller", 3, lambda run: run[-1, 6]),
    ("the same: time to 63 % of that speed [s]", "propeller", 1, lambda run: _time_to(run[:, 6], 0.632 * run[-1, 6])),
    ("rudder step of 5 deg at 1200 rpm: yaw rate [deg/s]", "rudder", 2, lambda run: degrees(run[-1, 11])),
    ("the same: drift angle [deg]", "rudder", 2, lambda run: degrees(atan2(-run[-1, 7], run[-1, 6]))),
    ("stern plane step of 5 deg: pitch [deg]", "stern", 2, lambda run: degrees(run[-1, 4])),
    ("the same: fastest pitching [deg/s]", "stern", 2, lambda run: degrees(run[:, 10].min())),
    ("the same: depth after 55 s [m]", "stern", 2, lambda run: run[-1, 2]),
    (
        "turning circle, rudder 15 deg: diameter [m]",
        "circle",
        2,
        lambda run: 2.0 * hypot(run[-1, 6], run[-1, 7]) / run[-1, 11],
    ),
    ("the same: speed [m/s]", "circle", 3, lambda run: hypot(run[-1, 6], run[-1, 7])),
    ("the same: heel [deg]", "circle", 2, lambda run: degrees(run[-1, 3])),
    ("dive, 15 deg down for 10 s, 5 deg up for 10 s: depth after 60 s [m]", "dive", 2, lambda run: run[-1, 2]),
    ("the same: steepest pitch [deg]", "dive", 2, lambda run: degrees(run[:, 4].min())),
    ("current of 0.5 m/s from astern: speed over ground [m/s]", "astern", 3, lambda run: run[-1, 6]),
    ("current of 0.5 m/s from abeam: set to the side after 30 s [m]", "abeam", 2, lambda run: run[60, 1]),
)


def _time_to(values: Run, level: float) -> float:
    """The first time [s] at which a growing value is at a level."""
    return float(np.interp(level, values, np.arange(len(values)) * EVERY_S))


def stored() -> dict[str, tuple[Run, Run]]:
    """For each manoeuvre the run of the reference, and that of the reference with our terms of the hull."""
    with np.load(FILE) as file:
        return {name: (file[name], file[f"{name}, our hull"]) for name in MANOEUVRES}


def driven(manoeuvre: Manoeuvre, h: float = 0.02) -> Run:
    """A run of our plant: its actuators are told what to do, in place of forces."""
    c = manoeuvre.current
    water = Water((c * cos(manoeuvre.towards), c * sin(manoeuvre.towards), 0.0), (0.0,) * 6)
    u, n = (1.9, 1200.0) if manoeuvre.cruising else (0.0, 0.0)
    state: tuple[float, ...] = (*(0.0,) * 6, u, *(0.0,) * 5, n, 0.0, 0.0)
    rows = []
    for k in range(round(manoeuvre.seconds / h) + 1):
        if k % round(EVERY_S / h) == 0:
            rows.append(state)
        state = advance(state, manoeuvre.commands(k * h), water, h)
    return np.array(rows)


def reference(manoeuvre: Manoeuvre, our_hull: bool) -> Run:
    """A run of `python_vehicle_simulator`.

    Args:
        manoeuvre: what happens.
        our_hull: its lift, cross-flow drag and low-speed damping in heave are replaced by ours, written here a second
            time (docs/background/plants.md); and a current carries the whole motion along.
    """
    from python_vehicle_simulator.vehicles import remus100 as module

    kept = module.forceLiftDrag, module.crossFlowDrag
    carried = our_hull and manoeuvre.current
    try:
        vehicle = module.remus100(
            V_current=0.0 if carried else manoeuvre.current, beta_current=np.degrees(manoeuvre.towards)
        )
        if our_hull:
            heave_damping = vehicle.M[2][2] / vehicle.T_heave
            module.forceLiftDrag = lambda *_: np.zeros(6)
            module.crossFlowDrag = lambda L, B, _, nu: _hull(L, B, vehicle.S, vehicle.CD_0, heave_damping, nu)
        return _driven(vehicle, manoeuvre, manoeuvre.current if carried else 0.0)
    finally:
        module.forceLiftDrag, module.crossFlowDrag = kept


def _driven(vehicle: Any, manoeuvre: Manoeuvre, drift: float) -> Run:
    from python_vehicle_simulator.lib.gnc import attitudeEuler

    eta = np.zeros(6)
    c, s = drift * cos(manoeuvre.towards), drift * sin(manoeuvre.towards)
    nu = np.array([1.9 if manoeuvre.cruising else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) - np.array([c, s, 0.0, 0.0, 0.0, 0.0])
    actual = np.array([0.0, 0.0, 1200.0 if manoeuvre.cruising else 0.0])
    rows = []
    for k in range(round(manoeuvre.seconds / STEP_S) + 1):
        t = k * STEP_S
        if k % round(EVERY_S / STEP_S) == 0:
            phi, theta, psi = eta[3:]
            down = sin(theta) * sin(phi), sin(theta) * cos(phi)
            over_ground = nu[:3] + np.array(
                [
                    cos(psi) * cos(theta) * c + sin(psi) * cos(theta) * s,
                    (cos(psi) * down[0] - sin(psi) * cos(phi)) * c + (sin(psi) * down[0] + cos(psi) * cos(phi)) * s,
                    (cos(psi) * down[1] + sin(psi) * sin(phi)) * c + (sin(psi) * down[1] - cos(psi) * sin(phi)) * s,
                ]
            )
            place = eta[:3] + np.array([c * t, s * t, 0.0])
            rows.append(np.r_[place, eta[3:], over_ground, nu[3:], actual[2], actual[0], actual[1]])
        n, rudder, stern = manoeuvre.commands(t)
        nu_next, actual = vehicle.dynamics(eta, nu.copy(), actual, np.array([rudder, stern, n]), STEP_S)
        eta = attitudeEuler(eta, nu, STEP_S)
        nu = nu_next
    return np.array(rows)


def _hull(L: float, B: float, S: float, C_D0: float, heave_damping: float, nu: Run) -> Run:
    """Lift and drag alike to all sides, strips along the hull across the flow in both planes [N, N m]."""
    rho, strips = 1026.0, 400
    u, v, w, _, q, r = nu
    x = (np.arange(strips) + 0.5) * L / strips - 0.5 * L
    across = np.hypot(v, w)
    speed2 = u * u + across * across
    alpha = np.arctan2(across, u)
    aspect = B * B / S
    C_L = pi * aspect / (1.0 + np.sqrt(1.0 + (aspect / 2.0) ** 2)) * np.sin(alpha) * np.cos(alpha)
    C_D = C_D0 + C_L * C_L / (pi * 0.7 * aspect)
    lift, drag = 0.5 * rho * speed2 * S * C_L, 0.5 * rho * speed2 * S * C_D
    side = -(lift * np.cos(alpha) + drag * np.sin(alpha))
    to_v, to_w = (v / across, w / across) if across else (0.0, 0.0)
    section = -0.5 * rho * B * 1.2 * L / strips
    sway, heave = (section * np.abs(flow) * flow for flow in (v + x * r, w - x * q))
    fades = heave_damping * (1.0 - exp(-3.0 * np.sqrt(speed2))) * w
    return np.array(
        [
            lift * np.sin(alpha) - drag * np.cos(alpha),
            side * to_v + sway.sum(),
            side * to_w + heave.sum() + fades,
            0.0,
            -(x * heave).sum(),
            (x * sway).sum(),
        ]
    )


def draw() -> None:
    """The picture of docs/background/plants.md."""
    from fleet.addons.pictures import style
    from fleet.palette import COLOURS

    figure, axes = style.panels(2, 2, height=4.6, share=False)
    table = stored()
    shown = (
        ("circle", "turning circle, rudder 15 deg", "east [m]", "north [m]", lambda run: (run[:, 1], run[:, 0])),
        (
            "rudder",
            "rudder step of 5 deg at 5 s",
            "time [s]",
            "yaw rate [deg/s]",
            lambda run: (None, np.degrees(run[:, 11])),
        ),
        (
            "stern",
            "stern plane step of 5 deg at 5 s",
            "time [s]",
            "pitch [deg]",
            lambda run: (None, np.degrees(run[:, 4])),
        ),
        (
            "astern",
            "current of 0.5 m/s from astern",
            "time [s]",
            "speed over ground [m/s]",
            lambda run: (None, run[:, 6]),
        ),
    )
    for ax, (name, title, x_label, y_label, columns) in zip(axes, shown, strict=True):
        theirs, same_hull = table[name]
        lines = (
            (theirs, "reference", {"color": "0.7", "linewidth": style.HEAVY}),
            (driven(MANOEUVRES[name]), "remus100", {"color": COLOURS[0]}),
            (same_hull, "reference with our hull", {"color": "black", "linestyle": ":"}),
        )
        for run, label, look in lines:
            x, y = columns(run)
            ax.plot(np.arange(len(run)) * EVERY_S if x is None else x, y, label=label, **look)
        ax.set(title=title, xlabel=x_label, ylabel=y_label)
    axes[0].set_aspect("equal")
    style.legend(figure, axes[0], 3)
    for ax in axes[2:]:
        ax.set_xlim(0.0, 30.0)
    style.save(figure, ROOT / "docs" / "background" / "plants-remus")


if __name__ == "__main__":
    if "--picture" not in sys.argv:
        runs = {}
        for name, manoeuvre in MANOEUVRES.items():
            runs[name] = reference(manoeuvre, False)
            runs[f"{name}, our hull"] = reference(manoeuvre, True)
        np.savez_compressed(FILE, **{name: run.astype(np.float32) for name, run in runs.items()})
    draw()
