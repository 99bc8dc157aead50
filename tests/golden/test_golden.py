"""Controller and plant against reference trajectories by an independent implementation.

When one of these fails, `test_every_variable_of_the_first_samples` names the first variable that differs.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
import pytest
from loops import OFFSETS, REFERENCE, TICK_NS, WEIGHTS, Link, Sample, agent_config, run_loop, world_config
from repository import GOLDEN

from agents.agent import Agent
from agents.config import AgentConfig, Extrapolation
from agents.signals import SignalLayout
from world.config import Harmonic
from world.disturbance import PAPER
from world.sea import World

TICKS = 6000
EVERY = 10


class Case(NamedTuple):
    profile: str
    disturbance: tuple[Harmonic, ...] = ()
    extrapolation: Extrapolation = "hold"
    round_ticks: int = 1
    delay_ticks: int = 0
    controller: str = "nboc"


CASES = {
    "NBOC_undisturbed": Case("paper"),
    "NBOC_disturbed": Case("paper", PAPER),
    "BOC_undisturbed": Case("paper", controller="boc"),
    "NBC_undisturbed": Case("paper", controller="nbc"),
    "BC_undisturbed": Case("paper", controller="bc"),
    "BSMC_undisturbed": Case("paper", controller="bsmc"),
    "NBOC_C_undisturbed": Case("consistent"),
    "NBOC_H_undisturbed": Case("hardened"),
    "net_1tick_hold": Case("paper", delay_ticks=1),
    "net_10Hz_dr": Case("paper", (), "neighbour", 10, 1),
    "net_10Hz_dr_disturbed": Case("paper", PAPER, "neighbour", 10, 1),
    "NBOC_H_comms_10Hz_0p5s_hold": Case("hardened", (), "hold", 10, 50),
}

TOLERANCE = {"eta": 1e-6, "nu": 1e-6, "e": 1e-6, "rho": 1e-6, "cmd": 1e-6, "K": 1e-5, "x": 1e-5, "tau": 1e-4}


def layout(case: Case) -> SignalLayout:
    return Agent(case_config(1, case)).layout


def columns(case: Case, name: str) -> slice:
    """Where a signal sits in the telemetry."""
    place = layout(case).where(name)
    assert place is not None, name
    return place


def case_config(i: int, case: Case) -> AgentConfig:
    return agent_config(i, case.profile, case.extrapolation, case.round_ticks, case.controller)


def run(case: Case, ticks: int) -> list[Sample]:
    agents = {i: Agent(case_config(i, case)) for i in (1, 2, 3, 4)}
    world = World(world_config(case.disturbance))
    return list(run_loop(agents, world, ticks, Link(case.round_ticks, case.delay_ticks)))


def true_error(tick: int, states: Any) -> Any:
    """The consensus error of the true positions [m], vehicle by axis."""
    position = np.array([eta[:3] for eta, _ in states])
    offsets = np.array(OFFSETS)
    t = tick * TICK_NS / 1e9
    e = position - (np.array(REFERENCE.start) + np.array(REFERENCE.velocity) * t + offsets)
    for (i, j), a in WEIGHTS.items():
        e[i - 1] += a * (position[i - 1] - position[j - 1] - (offsets[i - 1] - offsets[j - 1]))
    return e


# Its quick test is the run in test_fleet_golden.py, a third of it.
IN_WHOLE_RUNS = ("net_10Hz_dr",)


@pytest.mark.parametrize("part", [0.25, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in IN_WHOLE_RUNS else []) for name in CASES]
)
def test_reference_trajectory(name: str, part: float) -> None:
    """The first quarter or the whole 60 s, every 0.1 s, all vehicles."""
    case = CASES[name]
    samples = [s for s in run(case, int(part * TICKS)) if s.tick % EVERY == 0]
    telemetry = np.array([s.telemetry for s in samples[:-1]])
    ours = {
        "eta": np.array([[eta for eta, _ in s.states] for s in samples]),
        "nu": np.array([[nu for _, nu in s.states] for s in samples]),
        "e": np.array([true_error(s.tick, s.states) for s in samples]),
        "K": telemetry[..., columns(case, "K")],
        "rho": telemetry[..., columns(case, "rho")],
        "cmd": telemetry[..., columns(case, "u_cmd").start : columns(case, "psi_cmd").stop],
        "tau": np.array([s.tau for s in samples[:-1]]),
    }
    if layout(case).where("x") is not None:
        ours["x"] = telemetry[..., columns(case, "x")]
    with np.load(GOLDEN / f"{name}.npz") as golden:
        worst = {key: float(np.abs(value - golden[key][: len(value)]).max()) for key, value in ours.items()}
    assert not {key: error for key, error in worst.items() if not error <= TOLERANCE[key]}, worst


# In the order of computing: (name in the trace, signal, element, tolerance).
TRACED = [
    *[("e", "e_used", n, 1e-6) for n in range(3)],
    *[("K", "K", n, 1e-5) for n in range(3)],
    *[("rho", "rho", n, 1e-6) for n in range(3)],
    ("uc", "u_cmd", 0, 1e-6),
    ("thc", "theta_cmd", 0, 1e-6),
    ("psc", "psi_cmd", 0, 1e-6),
    ("ut", "u_err", 0, 1e-6),
    ("tht", "theta_err", 0, 1e-6),
    ("pst", "psi_err", 0, 1e-6),
    ("qt", "q_err", 0, 1e-5),
    ("rt", "r_err", 0, 1e-5),
    *[(f"x{n + 1}", "x", n, 1e-5) for n in range(3)],
    ("T1raw", "demand", 0, 1e-4),
]


@pytest.mark.parametrize("name", ["NBOC_undisturbed", "NBOC_disturbed"])
def test_every_variable_of_the_first_samples(name: str) -> None:
    trace = json.loads((GOLDEN / "trace.json").read_text())[name]
    samples = run(CASES[name], trace[-1]["k"] + 1)
    for line in trace:
        k = line["k"]
        sample = samples[k]
        for vehicle in range(4):
            where = f"{name}, sample {k}, vehicle {vehicle + 1}: "
            state = [*sample.states[vehicle][0], *sample.states[vehicle][1]]
            assert state == pytest.approx([row[vehicle] for row in line["X"]], abs=1e-6), where + "state"
            for key, signal, element, tolerance in TRACED:
                theirs = line[key][vehicle]
                theirs = theirs[element] if isinstance(theirs, list) else theirs
                ours = sample.telemetry[vehicle][columns(CASES[name], signal)][element]
                assert ours == pytest.approx(theirs, abs=tolerance), f"{where}{key}[{element}] -> {signal}"
            tau = [row[vehicle] for row in line["tau"]]
            assert list(sample.tau[vehicle]) == pytest.approx(tau, abs=1e-4), where + "tau"
