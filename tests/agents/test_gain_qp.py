"""The online gain optimisation: optimal, feasible, and the paper's problem rather than some other."""

from __future__ import annotations

import json
import math
import random
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import piqp
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from marks import slow
from piqp import instruction_set
from repository import GOLDEN
from samples import samples

from agents.config import GuidanceParams
from agents.laws.gain_qp import FIXED_RANGE, GainProblem, NoSolution, Solution, build_qp, solve
from agents.laws.guidance import REFUSED, OptimalGuidance
from agents.profiles import PROFILES, profile
from agents.sample import Sample
from agents.trajectory import Motion
from fleet.scenario.loading import load_scenario
from world.vectors import Vec3

RHO_D = (0.7, 0.1, 0.0)
PAPER = profile("paper")[0]

# Errors of every size: the formation's start, its end, none at all, and absurd ones.
error = st.one_of(
    st.just(0.0), st.floats(-8.0, 8.0), st.floats(-1e-3, 1e-3), st.floats(-1e-8, 1e-8), st.floats(-1e3, 1e3)
)
vector = st.tuples(error, error, error)
velocity = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
gain = st.tuples(st.floats(0.01, 2.0), st.floats(0.01, 2.0), st.floats(0.01, 2.0))
weight = st.floats(1.0, 3.0)
TUNINGS = [
    *(params for params, _ in PROFILES.values()),
    replace(PAPER, k_min=0.001, k_max=5.0),
    replace(PAPER, Q=(1.0, 10.0, 30.0), R2=(0.0, 1.0, 4.0)),
]
tunings = st.sampled_from(TUNINGS)


def total_cost(
    K: Vec3, e: Vec3, c: float, rho0: Vec3, K0: Vec3, g: GuidanceParams
) -> float:  # the paper's (17)-(20) with nothing eliminated
    moving = g.cost == "consistent"
    cost = 0.0
    for i in range(3):
        rho = RHO_D[i] - K[i] * e[i]
        effort = rho - RHO_D[i] if moving else rho
        e1 = e[i] + c * g.horizon_s * effort
        cost += g.Q[i] * e1**2 + g.R1[i] * effort**2 + g.R2[i] * (rho - rho0[i]) ** 2
        cost += g.p * (K[i] - K0[i]) ** 2
    return cost


def closed_form(problem: GainProblem) -> Vec3:
    """The oracle: P is diagonal, so each axis is a parabola on an interval."""
    K = [min(max(-q / P, lo), hi) for P, q, lo, hi, _ in zip(*problem, strict=True)]
    return K[0], K[1], K[2]


def solved(problem: GainProblem) -> Solution:
    outcome = solve(problem)
    assert isinstance(outcome, Solution), outcome
    return outcome


def test_agrees_with_an_independent_implementation() -> None:
    cases = json.loads((GOLDEN / "unit_vectors.json").read_text())["qp"]
    assert cases
    for case in cases:
        params = replace(
            PAPER,
            Q=(case["Q"],) * 3, R1=(case["R1"],) * 3, R2=(case["R2"],) * 3, p=case["p"],
            k_min=case["k_min"], k_max=case["k_max"],
            rho_lo=tuple(case["lo"]), rho_hi=tuple(case["hi"]), horizon_s=case["dt"],
            cost="consistent" if case["cost"] == "consistent" else "printed",
        )  # fmt: skip
        e, rho_d = tuple(case["e"]), tuple(case["vd"])
        gains = solved(build_qp(e, case["c"], rho_d, tuple(case["rho0"]), tuple(case["k0"]), params)).K
        assert gains == pytest.approx(case["K"], abs=1e-5)
        rho = [v - k * x for v, k, x in zip(rho_d, gains, e, strict=True)]
        assert rho == pytest.approx(case["rho"], abs=1e-6)


@given(vector, weight, velocity, gain, gain, gain, tunings)
def test_the_three_variables_carry_the_whole_cost(
    e: Vec3, c: float, rho0: Vec3, K0: Vec3, A: Vec3, B: Vec3, g: GuidanceParams
) -> None:
    """Eliminating rho and e1 changes the cost by a constant only: differences between gains are equal."""
    P, q, *_ = build_qp(e, c, RHO_D, rho0, K0, g)

    def reduced(K: Vec3) -> float:
        return sum(0.5 * Pi * k * k + qi * k for Pi, qi, k in zip(P, q, K, strict=True))

    full = total_cost(A, e, c, rho0, K0, g) - total_cost(B, e, c, rho0, K0, g)
    scale = 1.0 + max(map(abs, P)) + max(map(abs, q))
    assert reduced(A) - reduced(B) == pytest.approx(full, abs=1e-11 * scale)


@given(vector, weight, velocity, gain, tunings)
@example((0.0, 0.0, 0.0), 1.8, (0.1, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
@example((1e3, -1e3, 1e3), 2.8, (0.1, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
def test_kkt_and_closed_form(e: Vec3, c: float, rho0: Vec3, K0: Vec3, g: GuidanceParams) -> None:
    """Stationary inside the box, pushed outward at its faces."""
    problem = build_qp(e, c, RHO_D, rho0, K0, g)
    K = solved(problem).K
    for k, exact, P, q, lo, hi, x in zip(K, closed_form(problem), *problem, strict=True):
        assert lo <= k <= hi
        assert abs(k - exact) <= FIXED_RANGE
        assert abs((k - exact) * x) <= FIXED_RANGE
        slope = P * k + q
        near = 1e-5 * P
        assert slope >= -near or hi - k <= 1e-5
        assert slope <= near or k - lo <= 1e-5


@given(vector, weight, velocity, gain, tunings)
def test_the_gain_beats_its_feasible_neighbours(e: Vec3, c: float, rho0: Vec3, K0: Vec3, g: GuidanceParams) -> None:
    problem = build_qp(e, c, RHO_D, rho0, K0, g)
    K = solved(problem).K
    for axis in range(3):
        P, q, lo, hi, _ = (part[axis] for part in problem)
        k = K[axis]
        best = 0.5 * P * k * k + q * k
        for step in (-0.1, -1e-3, 1e-3, 0.1):
            other = min(max(k + step, lo), hi)
            assert best <= 0.5 * P * other * other + q * other + 1e-9 * (1.0 + P + abs(q))


@given(vector, weight, velocity, gain, tunings)
def test_the_bounds_win_over_the_least_gain(e: Vec3, c: float, rho0: Vec3, K0: Vec3, g: GuidanceParams) -> None:
    """rho stays within its bounds and the gain is never negative, if need be below k_min."""
    K = solved(build_qp(e, c, RHO_D, rho0, K0, g)).K
    for axis in range(3):
        rho = RHO_D[axis] - K[axis] * e[axis]
        assert g.rho_lo[axis] - 1e-9 <= rho <= g.rho_hi[axis] + 1e-9
        assert 0.0 <= K[axis] <= g.k_max


@given(vector, weight, velocity, velocity, gain, tunings)
@example((-2.0, 0.1, 0.1), 2.0, (2.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
@example((2.0, 0.1, 0.1), 2.0, (2.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
@example((0.0, 0.1, 0.1), 2.0, (2.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
def test_a_gain_keeps_both_bounds_whatever_the_reference_or_there_is_none(
    e: Vec3, c: float, rho_d: Vec3, rho0: Vec3, K0: Vec3, g: GuidanceParams
) -> None:
    """The velocity of the formation may lie outside the bounds, as the mean of what neighbours sent does at times. With
    the one bound that the error points to, 250 of 1,500 such problems were called solved and had no solution."""
    outcome = solve(build_qp(e, c, rho_d, rho0, K0, g), "exact")
    room = math.inf  # the least of the axes, by which a rho that some gain gives lies within the bounds
    for v, x, lo, hi in zip(rho_d, e, g.rho_lo, g.rho_hi, strict=True):
        reached = sorted((v, v - g.k_max * x))
        room = min(room, min(reached[1], hi) - max(reached[0], lo))
    if isinstance(outcome, NoSolution):
        assert room <= 1e-9
        return
    assert room >= -1e-9
    for v, k, x, lo, hi in zip(rho_d, outcome.K, e, g.rho_lo, g.rho_hi, strict=True):
        assert 0.0 <= k <= g.k_max
        assert lo - 1e-9 <= v - k * x <= hi + 1e-9


def test_the_answer_does_not_depend_on_the_problems_before() -> None:
    first = build_qp((0.3, -0.2, 0.1), 2.8, RHO_D, (0.6, 0.1, 0.0), (0.9, 1.0, 1.1), PAPER)
    second = build_qp((-4.2, -1.0, -5.0), 1.8, RHO_D, (0.1, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
    alone = solved(first)
    solve(second)
    assert solved(first) == alone


def test_when_no_gain_keeps_the_bounds_the_problem_comes_back() -> None:
    """A reference outside the bounds: nothing with k >= 0 helps where the error points further out."""
    params = replace(PAPER, rho_hi=(0.5, 1.0, 1.25))
    problem = build_qp((-1.0, 0.2, 0.1), 2.0, RHO_D, RHO_D, (0.3, 0.3, 0.3), params)
    outcome = solve(problem)
    assert isinstance(outcome, NoSolution)
    assert outcome.problem == problem
    assert "axis 0" in outcome.reason


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_problem_without_finite_numbers_comes_back(broken: float) -> None:
    problem = build_qp((0.3, 0.2, 0.1), 2.0, RHO_D, (broken, 0.0, 0.0), (0.3, 0.3, 0.3), PAPER)
    assert isinstance(solve(problem), NoSolution)


def test_a_flat_cost_comes_back() -> None:
    flat = build_qp((0.0, 0.2, 0.1), 2.0, RHO_D, RHO_D, (0.3, 0.3, 0.3), replace(PAPER, p=0.0))
    outcome = solve(flat)
    assert isinstance(outcome, NoSolution)
    assert "does not depend" in outcome.reason


def test_a_solver_that_gives_up_counts_and_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it is not given enough iterations."""

    solver_class = piqp.DenseSolver

    def hurried() -> piqp.DenseSolver:
        solver = solver_class()
        solver.settings.max_iter = 1
        return solver

    problem = build_qp((0.3, -0.2, 0.1), 2.8, RHO_D, (0.6, 0.1, 0.0), (0.9, 1.0, 1.1), PAPER)
    before = solved(problem)
    assert not before.refused
    monkeypatch.setattr(piqp, "DenseSolver", hurried)
    assert solved(problem) == Solution(before.K, 1, "PIQP: max iter reached")
    assert solve(problem, "exact") == Solution(before.K)


class _SloppySolver:
    """Answers with the least gains, which it calls optimal."""

    def __init__(self) -> None:
        self.settings, self.result = SimpleNamespace(), SimpleNamespace(info=SimpleNamespace(iter=1))

    def setup(self, P: object, c: object, *, x_l: object, x_u: object) -> None:
        self.result.x = x_l

    def solve(self) -> piqp.Status:
        return piqp.PIQP_SOLVED


def test_an_answer_of_the_solver_that_is_not_optimal_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(piqp, "DenseSolver", _SloppySolver)
    law = OptimalGuidance(load_scenario("paper").agent_config(1))
    sample = Sample(0, 0.0, 0.01, (0.0,) * 5, (0.5, 0.0, 0.0, 0.0, 0.0), RHO_D, Motion((0.0,) * 3, RHO_D), (),
                    (0.3, -0.2, 0.1), 2.8, "")  # fmt: skip
    exact = solve(build_qp(sample.e, sample.c, RHO_D, RHO_D, law.K, PAPER), "exact")
    assert isinstance(exact, Solution)
    assert law.step(sample)[1] == (*exact.K, REFUSED, 1.0)


BUILDS = {"piqp_python": True, "piqp_python_avx2": instruction_set.avx2, "piqp_python_avx512": instruction_set.avx512f}
PROBLEMS = 100_000
USED = str(piqp.DenseSolver.__module__).rpartition(".")[2]  # the one that piqp has chosen for this processor


@pytest.mark.parametrize("build", [USED, *slow(*(build for build, runs in BUILDS.items() if runs and build != USED))])
def test_every_build_of_the_solver_agrees_with_the_formula(build: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit, so it does not matter which of its builds a processor gets."""
    module = import_module(f"piqp.{build}")
    monkeypatch.setattr(piqp, "DenseSolver", module.DenseSolver)
    monkeypatch.setattr(piqp, "PIQP_SOLVED", module.PIQP_SOLVED)
    draw, asked = random.Random(1), 0

    def error() -> float:
        size = draw.choice((0.0, 1e-8, 1e-3, 8.0, 1e3))
        return draw.uniform(-size, size)

    while asked < samples(PROBLEMS):
        e, c, tuning = (error(), error(), error()), draw.uniform(1.0, 3.0), draw.choice(TUNINGS)
        rho0, K0 = draw.uniform(-1.5, 1.5), draw.uniform(0.01, 2.0)
        problem = build_qp(e, c, RHO_D, (rho0, -rho0, 0.5 * rho0), (K0, 0.5 * K0, 0.1), tuning)
        found = solved(problem)
        asked += found.iterations > 0
        assert not found.refused
        assert solve(problem, "exact") == Solution(found.K)
