"""The runs behind the report: which scenario each is, and what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import tau
from typing import Any

import numpy as np

import fleet
from agents.controllers import CONTROLLERS
from agents.laws.kinematics import earth_velocity
from fleet.recorder.metrics import SETTLE_FRACTION, SETTLE_M
from fleet.recorder.settling import settling_time
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.private_folder import PrivateFolder
from world.tumble import LIMIT_RAD

CALM_LATE_S = 10.0  # undisturbed, "late" is this long
FIRST_S = 2.0  # the initial effort is counted over so long
PEAK_AFTER_S = 5.0  # what comes later is no part of the start any more
SIGNALS = {  # by topic of a vehicle, of which the report needs each sample
    "state": (), "error": ("e",), "command": ("applied",), "guidance": ("rho", "u_cmd", "K"),
    "control": ("u_err", "q_err", "r_err", "demand"),
}  # fmt: skip
ETA, NU = ("x", "y", "z", "theta", "psi"), ("u", "v", "w", "q", "r")

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(slots=True)
class Recording:
    """One run: every signal as an array (sample, vehicle, component), from t = 0; NaN where none is logged."""

    scenario: Scenario
    t: Array  # s, shape (samples,)
    signals: dict[str, Array] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]


def recording_of(log: fleet.Log) -> Recording:
    scenario = log.scenario
    t = max((log[f"uuv/{i}/state"].t for i in range(1, scenario.vehicles + 1)), key=len)
    made = Recording(scenario, t)
    for i in range(1, scenario.vehicles + 1):
        for name, fields in SIGNALS.items():
            topic = log[f"uuv/{i}/{name}"]
            values = {field: topic[field].reshape(len(topic), -1) for field in fields if field in topic.units}
            if name == "state":
                values = {
                    "eta": np.stack([topic[each] for each in ETA], axis=1),
                    "nu": np.stack([topic[each] for each in NU], axis=1),
                }
            for key, value in values.items():
                of_all = made.signals.setdefault(key, np.full((len(t), scenario.vehicles, value.shape[1]), np.nan))
                of_all[np.searchsorted(t, topic.t), i - 1] = value
    made.signals["z"] = np.sqrt(made["u_err"] ** 2 + made["q_err"] ** 2 + made["r_err"] ** 2)
    return made


def vehicle_measures(recording: Recording) -> list[dict[str, Any]]:
    """The numbers of each vehicle; `late` is what `late_s` says."""
    t, tick = recording.t, recording.scenario.tick_ns / 1e9
    late = t >= t[-1] - late_s(recording) - 1e-9
    first, after = t < FIRST_S - 1e-9, t >= PEAK_AFTER_S - 1e-9
    rows = []
    for i in range(recording.scenario.vehicles):
        e = np.linalg.norm(recording["e"][:, i], axis=1)
        z, tau_, demand = recording["z"][:, i, 0], recording["applied"][:, i], recording["demand"][:, i]
        rho, K, theta = recording["rho"][:, i], recording["K"][:, i], recording["eta"][:, i, 3]
        rows.append(
            {
                "settle_10pct_s": _settle(recording, e, SETTLE_FRACTION * e[0]),
                "settle_5cm_s": _settle(recording, e, SETTLE_M),
                "e_rms_m": _rms(e[late]),
                "e_max_late_m": float(e[late].max()),
                "z_rms_mps": _rms(z[late]),
                "z_peak_mps": _largest(z[after]),
                "z_max_mps": _largest(z),
                "demand_start": [float(abs(x)) for x in demand[0]],
                "demand_peak": [_largest(np.abs(x)) for x in demand.T],
                "effort_first": [float(x) for x in np.nansum(np.abs(tau_[first]), axis=0) * tick],
                "effort": [float(x) for x in np.nansum(np.abs(tau_), axis=0) * tick],
                "u_cmd_max_mps": _largest(recording["u_cmd"][:, i, 0]),
                "rho_first_step_mps": float(np.linalg.norm(rho[0] - _velocity(recording, i))),
                "rho_step_max_mps": _largest(np.linalg.norm(np.diff(rho, axis=0), axis=1)),
                "rho_min_mps": [-_largest(-x) for x in rho.T],
                "rho_max_mps": [_largest(x) for x in rho.T],
                "theta_max_deg": float(np.degrees(np.abs(theta).max())),
                "tumbled_s": tumble_time(t, theta),
                "u_min_mps": float(recording["nu"][:, i, 0].min()),
                "K_span": _span(K),
                "K_late_mean": _mean(K[late]),
                "K_late_span": _span(K[late]),
            }
        )
    return rows


def late_s(recording: Recording) -> float:
    """How much of a run's end is *late* [s]: 10 s, or the whole periods of the disturbance in the second half."""
    disturbance = recording.scenario.disturbance
    if not disturbance:
        return CALM_LATE_S
    period = tau / min(h.omega for h in disturbance)
    return period * max(1, int(recording.t[-1] / 2 / period))


def tumble_time(t: Array, theta: Array) -> float | None:
    """When a vehicle first stood beyond 80 deg of pitch [s]; None if it never did."""
    beyond = np.flatnonzero(np.abs(theta) > LIMIT_RAD)
    return float(t[beyond[0]]) if len(beyond) else None


def _settle(recording: Recording, e: Array, limit: float) -> float | None:
    return settling_time(recording.t.tolist(), e.tolist(), limit, recording.scenario.disturbance)


def _velocity(recording: Recording, i: int) -> Array:
    """Velocity over ground at t = 0 [m/s, NED], which stands for the rho before the first."""
    eta, nu = recording["eta"][0, i], recording["nu"][0, i]
    return np.array(earth_velocity(tuple(eta.tolist()), tuple(nu.tolist())))


def _rms(values: Array) -> float:
    finite = _finite(values)
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def _largest(values: Array) -> float:
    finite = _finite(values)
    return float(finite.max()) if len(finite) else float("nan")


def _span(values: Array) -> list[float]:
    finite = _finite(values)
    return [float(x) for x in np.ptp(finite, axis=0)] if len(finite) else [float("nan")] * values.shape[1]


def _mean(values: Array) -> list[float]:
    finite = _finite(values)
    return [float(x) for x in finite.mean(axis=0)] if len(finite) else [float("nan")] * values.shape[1]


def _finite(values: Array) -> Array:
    rows = np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    return values[rows]


U, D = "undisturbed", "disturbed"
SEAS = (U, D)
NAMES = tuple(name.upper() for name in CONTROLLERS)

# Simulated seconds. Undisturbed, everything is over after 20 s. Under the periodic disturbance a gain without a bound
# takes a minute until the loop bursts for the first time, so whatever is compared there runs for two.
CALM_S, LONG_S = 60, 120
LENGTH_S = {"sensitivity": 60, "network": 60, "exact": 60, "unlimited": 40}  # of other groups of cases
EVERY_S = 0.05  # between the samples that pictures get


@dataclass(frozen=True, slots=True)
class Case:
    name: str
    group: str  # paper | consistent | no-k_max | network | sensitivity | exact | unlimited
    controller: str
    sea: str
    overrides: tuple[str, ...] = ()
    what: str = ""  # in words, for the report

    @property
    def seconds(self) -> int:
        return LENGTH_S.get(self.group, CALM_S if self.sea == U else LONG_S)

    def scenario(self) -> Scenario:
        sea = () if self.sea == U else ("sea.disturbance=paper",)
        # Some of the paper's comparisons do go astern, and what the law as printed then does is their result.
        printed = "tracking.astern=printed"
        base = ("checks={}", printed, f"controller={self.controller.lower()}", f"duration={self.seconds} s")
        return load_scenario("ideal", [*base, *sea, *self.overrides])


_NETWORK = ("network={period: 10 ms}", "neighbours.extrapolate=neighbour")
_NO_K_MAX = "guidance.k_max=1000 1/s"
_UNLIMITED = (
    "vehicle={surge_force: 1000 kN, pitch_moment: 1000 kN m, yaw_moment: 1000 kN m}",
    "tracking.u_floor=0 m/s",
)


def _cases() -> list[Case]:
    optimised = [c for c in NAMES if c.endswith("OC")]
    # The long runs first: a worker that gets one last would be waited for.
    found = [Case(f"{c}-{sea}", "paper", c, sea, (), f"{c}, {sea}") for sea in (D, U) for c in NAMES]
    found += [
        Case(f"{c}-consistent-{sea}", "consistent", c, sea, ("profile=consistent",), f"{c}, corrected cost, {sea}")
        for sea in (D, U)
        for c in optimised
    ]
    found += [
        Case(f"{c}-no-k_max-{D}", "no-k_max", c, D, (_NO_K_MAX,), f"{c} without an upper bound on K") for c in optimised
    ]
    found += [
        Case(f"NBOC-network-{sea}", "network", "NBOC", sea, _NETWORK, f"NBOC over a network of one tick, {sea}")
        for sea in SEAS
    ]
    found += [
        Case("BC-K2-30-disturbed", "sensitivity", "BC", D,
             ("tracking={k_u: 30 1/s, k_q: 30 1/s, k_r: 30 1/s}",), "BC with K2 = 30, the shunting model's DC gain"),
        Case("NBC-b-10-disturbed", "sensitivity", "NBC", D,
             ("tracking={b_up: 10, b_down: 10}",), "NBC with b = 10, DC gain 1"),
        Case("BSMC-phi-0.1-disturbed", "sensitivity", "BSMC", D,
             ("tracking.phi=0.1 0.1 0.1",), "BSMC with a tenth of the boundary layer"),
    ]  # fmt: skip
    found += [
        Case(f"{c}-exact-{D}", "exact", c, D, ("tracking.angles=exact",), f"{c} with the exact angles of the velocity")
        for c in NAMES
    ]
    found += [
        Case(f"{c}-unlimited-{U}", "unlimited", c, U,
             (*_UNLIMITED, *((_NO_K_MAX,) if c in optimised else ())),
             f"{c} literally as printed: no actuator limit, no speed floor, no bound on K")
        for c in NAMES
    ]  # fmt: skip
    return found


CASES: dict[str, Case] = {case.name: case for case in _cases()}


@dataclass(slots=True)
class Outcome:
    """The record of one case: numbers per vehicle, and signals for the pictures."""

    name: str
    metrics: list[dict[str, Any]]
    t: Array
    signals: dict[str, Any] = field(default_factory=dict)  # float32 arrays (sample, vehicle, component), thinned
    inputs: dict[str, Any] = field(default_factory=dict)  # of UUV 1 at every sample: t, demand, applied
    broken: str = ""

    @property
    def tumbled(self) -> str:
        found = [(i, row["tumbled_s"]) for i, row in enumerate(self.metrics, start=1) if row["tumbled_s"] is not None]
        return "tumbled: " + ", ".join(f"UUV {i} at {t:.2f} s" for i, t in found) if found else ""

    @property
    def failure(self) -> str:
        """The fault of a run: a vehicle that tumbled, or an early end; empty: none."""
        ended = f"ended early: {self.broken}" if self.broken else ""
        return "; ".join(text for text in (self.tumbled, ended) if text)


_PICTURED = ("e", "rho", "u_cmd", "K", "z")


def run_case(name: str, progress: Any) -> Outcome:
    scenario = CASES[name].scenario()
    with PrivateFolder("reproduce") as folder, fleet.Run(scenario, log=folder / "run.mcap") as run:
        result = run.to_end(progress)
        recording = recording_of(fleet.open_log(folder / "run.mcap"))
    every = max(1, round(EVERY_S * 1e9 / scenario.tick_ns))
    kept = {key: recording[key][::every].astype(np.float32) for key in _PICTURED if key in recording.signals}
    inputs = {key: recording[key][:, 0].astype(np.float32) for key in ("demand", "applied")} | {"t": recording.t}
    return Outcome(name, vehicle_measures(recording), recording.t[::every], kept, inputs, result.reason)
