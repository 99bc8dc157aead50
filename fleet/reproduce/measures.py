"""The numbers that the report takes from a run, per vehicle and at every sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import tau
from typing import Any

import numpy as np

import fleet
from agents.laws.kinematics import earth_velocity
from fleet.recorder.metrics import SETTLE_FRACTION, SETTLE_M
from fleet.recorder.settling import settling_time
from fleet.scenario.scenario import Scenario
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


def recorded(log: fleet.Log) -> Recording:
    """The signals of a log."""
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
                "tumbled_s": tumbled(t, theta),
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


def tumbled(t: Array, theta: Array) -> float | None:
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
    """Largest minus smallest of each column."""
    finite = _finite(values)
    return [float(x) for x in np.ptp(finite, axis=0)] if len(finite) else [float("nan")] * values.shape[1]


def _mean(values: Array) -> list[float]:
    """Of each column."""
    finite = _finite(values)
    return [float(x) for x in finite.mean(axis=0)] if len(finite) else [float("nan")] * values.shape[1]


def _finite(values: Array) -> Array:
    rows = np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    return values[rows]
