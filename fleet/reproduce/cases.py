"""The runs behind the report: which scenario each is, and what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import fleet
from agents.controllers import CONTROLLERS
from fleet.reproduce.measures import Array, recorded, vehicle_measures
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.private_folder import PrivateFolder

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
    """One run of the report."""

    name: str
    group: str  # paper | consistent | no-k_max | network | sensitivity | exact | unlimited
    controller: str
    sea: str
    overrides: tuple[str, ...] = ()
    what: str = ""  # in words, for the report

    @property
    def seconds(self) -> int:
        """How long it runs."""
        return LENGTH_S.get(self.group, CALM_S if self.sea == U else LONG_S)

    def scenario(self) -> Scenario:
        """The paper's fleet with this case's changes."""
        sea = () if self.sea == U else ("sea.disturbance=paper",)
        base = ("checks={}", f"controller={self.controller.lower()}", f"duration={self.seconds} s")
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
        """Which vehicles tumbled, and when for the first time; empty: none."""
        found = [(i, row["tumbled_s"]) for i, row in enumerate(self.metrics, start=1) if row["tumbled_s"] is not None]
        return "tumbled: " + ", ".join(f"UUV {i} at {t:.2f} s" for i, t in found) if found else ""

    @property
    def failure(self) -> str:
        """The fault of a run: a vehicle that tumbled, or an early end; empty: none."""
        ended = f"ended early: {self.broken}" if self.broken else ""
        return "; ".join(text for text in (self.tumbled, ended) if text)


_PICTURED = ("e", "rho", "u_cmd", "K", "z")


def run_case(name: str, progress: Any) -> Outcome:
    """Run one case and measure it."""
    scenario = CASES[name].scenario()
    with PrivateFolder("reproduce") as folder, fleet.Run(scenario, log=folder / "run.mcap") as run:
        result = run.to_end(progress)
        recording = recorded(fleet.open_log(folder / "run.mcap"))
    every = max(1, round(EVERY_S * 1e9 / scenario.tick_ns))
    kept = {key: recording[key][::every].astype(np.float32) for key in _PICTURED if key in recording.signals}
    inputs = {key: recording[key][:, 0].astype(np.float32) for key in ("demand", "applied")} | {"t": recording.t}
    return Outcome(name, vehicle_measures(recording), recording.t[::every], kept, inputs, result.reason)
