"""The runs behind the report: which scenario each is, and the numbers taken from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS
from fleet.metrics import RMS_WINDOW_S, SETTLE_FRACTION, SETTLE_M
from fleet.recording import Array, Recording, record
from fleet.scenario import Scenario, load_scenario

U, D = "undisturbed", "disturbed"
SEAS = (U, D)
NAMES = tuple(name.upper() for name in CONTROLLERS)
SHORT_S = 40  # of the runs without actuator limits, which have settled or tumbled by then
FIRST_S = 2.0  # the initial effort is counted over so long
EVERY_S = 0.05  # between the samples that pictures get


@dataclass(frozen=True, slots=True)
class Case:
    """One run of the report."""

    name: str
    group: str  # paper | consistent | network | sensitivity | unlimited
    controller: str
    sea: str
    overrides: tuple[str, ...] = ()
    what: str = ""  # in words, for the report

    def scenario(self) -> Scenario:
        """The paper's fleet with this case's changes."""
        sea = () if self.sea == U else ("sea.disturbance=paper",)
        shorter = (f"duration={SHORT_S} s",) if self.group == "unlimited" else ()
        base = ("checks={}", f"controller={self.controller.lower()}")
        return load_scenario("ideal", [*base, *sea, *shorter, *self.overrides])


_NETWORK = ("network={period: 10 ms}", "neighbours.extrapolate=neighbour")
_UNLIMITED = (
    "vehicle={surge_force: 1000 kN, pitch_moment: 1000 kN m, yaw_moment: 1000 kN m}",
    "tracking.u_floor=0 m/s",
)


def _cases() -> list[Case]:
    found = [Case(f"{c}-{sea}", "paper", c, sea, (), f"{c}, {sea}") for sea in SEAS for c in NAMES]
    found += [
        Case(f"{c}-consistent-{sea}", "consistent", c, sea, ("profile=consistent",), f"{c}, corrected cost, {sea}")
        for sea in SEAS
        for c in ("NBOC", "BOC")
    ]
    found += [
        Case(
            f"NBOC-network-{sea}",
            "network",
            "NBOC",
            sea,
            _NETWORK,
            f"NBOC over the network at its least latency, {sea}",
        )
        for sea in SEAS
    ]
    found += [
        Case("BC-K2-30-disturbed", "sensitivity", "BC", D,
             ("tracking={k_u: 30 1/s, k_q: 30 1/s, k_r: 30 1/s}",), "BC with K2 = 30, the shunting model's DC gain"),
        Case("NBC-b-10-disturbed", "sensitivity", "NBC", D,
             ("tracking={b_up: 10, b_down: 10}",), "NBC with b = 10, DC gain 1"),
        Case("BSMC-phi-0.1-disturbed", "sensitivity", "BSMC", D,
             ("tracking.phi=0.1 0.1 0.1",), "BSMC with a tenth of the boundary layer"),
        Case("NBOC-no-k_max-disturbed", "sensitivity", "NBOC", D,
             ("guidance.k_max=1000 1/s",), "NBOC without an upper bound on K"),
        Case("BOC-no-k_max-disturbed", "sensitivity", "BOC", D,
             ("guidance.k_max=1000 1/s",), "BOC without an upper bound on K"),
    ]  # fmt: skip
    found += [
        Case(f"{c}-unlimited-undisturbed", "unlimited", c, U,
             (*_UNLIMITED, *(("guidance.k_max=1000 1/s",) if c.endswith("OC") else ())),
             f"{c} literally as printed: no actuator limit, no speed floor, no bound on K")
        for c in NAMES
    ]  # fmt: skip
    return found


CASES: dict[str, Case] = {case.name: case for case in _cases()}


@dataclass(slots=True)
class Outcome:
    """What is kept of one case: numbers per vehicle, and thinned signals for the pictures."""

    name: str
    metrics: list[dict[str, Any]]
    t: Array
    signals: dict[str, Any] = field(default_factory=dict)  # float32 arrays (sample, vehicle, component)
    broken: str = ""


_PICTURED = ("e", "tau", "rho", "u_cmd", "theta_cmd", "psi_cmd", "K", "demand", "z", "eta")


def run_case(name: str, progress: Any) -> Outcome:
    """Run one case and measure it."""
    scenario = CASES[name].scenario()
    recording = record(scenario, progress)
    recording.signals["z"] = np.sqrt(recording["u_err"] ** 2 + recording["q_err"] ** 2 + recording["r_err"] ** 2)
    every = max(1, round(EVERY_S * 1e9 / scenario.tick_ns))
    kept = {key: recording[key][::every].astype(np.float32) for key in _PICTURED if key in recording.signals}
    return Outcome(name, measure(recording), recording.t[::every], kept, recording.broken)


def measure(recording: Recording) -> list[dict[str, Any]]:
    """The numbers of each vehicle, at every sample of the run."""
    t, tick = recording.t, recording.scenario.tick_ns / 1e9
    late = t >= t[-1] - RMS_WINDOW_S - 1e-9
    first = t < FIRST_S - 1e-9
    rows = []
    for i in range(recording.scenario.vehicles):
        e = np.linalg.norm(recording["e"][:, i], axis=1)
        z, tau, demand = recording["z"][:, i, 0], recording["tau"][:, i], recording["demand"][:, i]
        rho, velocity = recording["rho"][:, i], _velocity(recording, i)
        rows.append(
            {
                "settle_10pct_s": settle(t, e, SETTLE_FRACTION * e[0]),
                "settle_5cm_s": settle(t, e, SETTLE_M),
                "e_rms_m": _rms(e[late]),
                "e_max_late_m": float(e[late].max()),
                "z_rms_mps": _rms(z[late]),
                "z_max_mps": float(np.nanmax(z)) if len(z) > 1 else 0.0,
                "demand_start": [float(abs(x)) for x in demand[0]],
                "demand_peak": [float(x) for x in np.nanmax(np.abs(demand), axis=0)],
                "effort_first": [float(x) for x in np.nansum(np.abs(tau[first]), axis=0) * tick],
                "effort": [float(x) for x in np.nansum(np.abs(tau), axis=0) * tick],
                "u_cmd_max_mps": float(np.nanmax(recording["u_cmd"][:, i])),
                "rho_first_step_mps": float(np.linalg.norm(rho[0] - velocity)),
                "rho_step_max_mps": float(np.nanmax(np.linalg.norm(np.diff(rho, axis=0), axis=1), initial=0.0)),
                "theta_max_deg": float(np.degrees(np.abs(recording["eta"][:, i, 3]).max())),
                "u_min_mps": float(recording["nu"][:, i, 0].min()),
                "K_late_mean": [float(x) for x in np.nanmean(recording["K"][late, i], axis=0)],
                "K_late_span": [float(x) for x in np.ptp(_finite(recording["K"][late, i]), axis=0)],
            }
        )
    return rows


def settle(t: Array, e: Array, limit: float) -> float | None:
    """The first time [s] after which e stays below the limit to the end; None if it does not."""
    above = np.flatnonzero(~(e < limit))
    if not len(above):
        return 0.0
    return None if above[-1] + 1 >= len(t) else float(t[above[-1] + 1])


def _velocity(recording: Recording, i: int) -> Array:
    """Velocity over ground at t = 0 [m/s, NED], which stands for the rho before the first."""
    from agents.kinematics import earth_velocity

    eta, nu = recording["eta"][0, i], recording["nu"][0, i]
    return np.array(earth_velocity(tuple(eta.tolist()), tuple(nu.tolist())))


def _rms(values: Array) -> float:
    finite = _finite(values)
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def _finite(values: Array) -> Array:
    rows = np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    return values[rows]
