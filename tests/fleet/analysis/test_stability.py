"""What theory says of a scenario: eigenvalues against the published ones, and every warning once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scenario import small

from fleet.analysis.stability import analyse, eigenvalues, matrices, oldest_s, report
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario


def fleet(graph: str, n: int = 4, *overrides: str) -> Scenario:
    return small(f"vehicles={n}", f"graph={graph}", "formation={shape: grid}", *overrides)


def test_the_paper_fleet() -> None:
    """L + B has eigenvalues from 1 to 4.065 and A the spectral radius 1.447 (docs/background/paper.md, G11)."""
    found = analyse(load_scenario("paper"))
    assert found.eigenvalues[0].real == pytest.approx(1.0)
    assert found.lambda_max == pytest.approx(4.065, abs=5e-4)
    assert found.spectral_radius_A == pytest.approx(1.447, abs=5e-4)
    assert found.gain_max == 2.0
    assert found.components == [[1, 2, 3, 4]]
    assert found.unreached == []
    assert found.warnings == []


def test_only_the_first_follows() -> None:
    """Its slowest mode is 0.158 times the gain."""
    found = analyse(load_scenario("paper", ["graph.reference=[1]"]))
    assert min(value.real for value in found.eigenvalues) == pytest.approx(0.158, abs=5e-4)
    assert any(
        "links lead from there to all other vehicles" in line
        for line in report(load_scenario("paper", ["graph.reference=[1]"]), found)
    )


@given(st.integers(2, 12), st.integers(0, 2**31), st.floats(0.0, 1.0))
@settings(max_examples=15)
def test_rows_of_the_laplacian_sum_to_zero(n: int, seed: int, probability: float) -> None:
    """(L + B) 1 = b, for any graph: a fleet that is displaced as a whole sees only its references."""
    scenario = fleet(f"{{shape: random, probability: {probability!r}, reference: [1]}}", n, f"seed={seed}")
    A, M = matrices(scenario)
    assert M.sum(axis=1) == pytest.approx(np.array(scenario.b))
    assert (A == A.T).all()
    found = analyse(scenario, linear=False)
    assert found.components == [list(range(1, n + 1))]
    assert found.unreached == []
    # Connected, symmetric and with one follower: positive definite (Lemma 1 where it is true).
    assert found.eigenvalues[0].real > 0.0


def test_parts_and_who_is_not_reached() -> None:
    scenario = fleet('{edges: {"1->2": 1, "4->3": 1}, reference: [1]}')
    found = analyse(scenario)
    assert found.components == [[1, 2], [3, 4]]
    assert found.unreached == [3, 4]
    assert "in 2 parts: vehicles 1, 2; vehicles 3, 4" in report(scenario, found)[0]
    assert any("to vehicles 3, 4. L+B is singular" in warning for warning in found.warnings)
    assert abs(found.eigenvalues[0]) < 1e-12
    # An edge carries information one way only.
    assert analyse(fleet('{edges: {"2->1": 1}, reference: [1]}', 2)).unreached == [2]


def test_a_dense_graph_needs_smaller_gains() -> None:
    """complete: lambda_max = N + 1; 1.4 1/s is below the rule of thumb's 1.429 and still too much; and a tracking law
    without shunting has no such limit."""
    for most in ("2", "1.4"):
        (warning,) = analyse(fleet("{shape: complete}", 6, f"guidance.k_max={most} 1/s")).warnings
        assert "above the limit of the linear loop. With these rounds and delays the limit is 1.16" in warning
    assert analyse(fleet("{shape: complete}", 6, "guidance.k_max=1.1 1/s")).warnings == []
    (warning,) = analyse(fleet("{shape: complete}", 21)).warnings  # too large a fleet for the linear loop
    assert "K lambda_max(L+B) = 44 1/s is not below a = 10 1/s" in warning
    assert "Set guidance.k_max below 0.4545 1/s; the true limit may be lower" in warning
    assert analyse(fleet("{shape: complete}", 6, "controller=boc")).warnings == []
    assert analyse(fleet("{shape: complete}", 6, "per_vehicle.1-6.controller=bc")).warnings == []


def test_dead_reckoning_needs_fresh_news() -> None:
    """The rule of thumb K tau rho(A) < 1 allows 0.691 s at K = 1 on the paper's graph, whose rho(A) is 1.447; the
    linear loop grows before that. The rule is told where the loop is not known."""
    slow = ["guidance.k_max=1 1/s", "network.period=500 ms"]
    late = load_scenario("paper", [*slow, "network.links={'*': 'delay 200ms'}"])
    (warning,) = analyse(late).warnings
    assert "K settles at (0.3, 0.3, 1) 1/s, above the limit of the linear loop" in warning
    assert "K tau rho(A) < 1: kept. 1 1/s x 0.69 s x 1.447 = 0.9986" in "\n".join(report(late, analyse(late)))
    later = [*slow, "network.links={'*': 'delay 210ms'}", "neighbours.drop_after=600 ms"]
    (warning,) = analyse(load_scenario("paper", later)).warnings
    assert "K tau rho(A) = 1.013 is not below 1 at an age of 0.7 s" in warning
    for other in ("hold", "reference"):
        links = "network.links={'*': 'delay 5s'}"
        assert analyse(load_scenario("paper", [*slow, links, f"neighbours.extrapolate={other}"])).warnings == []


@pytest.mark.parametrize(
    ("overrides", "age_s"),
    [
        ([], 0.1),
        (["network.period=10 ms"], 0.01),
        (["network.links={'*': 'delay 25ms'}"], 0.12),
        (["network=ideal"], 0.0),
    ],
)
def test_oldest_news(overrides: list[str], age_s: float) -> None:
    """A payload is used from its due tick until the next round's is due."""
    assert oldest_s(load_scenario("paper", overrides)) == pytest.approx(age_s)


def test_a_vehicle_whose_flow_angles_are_unstable() -> None:
    """With the usual sign of the added mass m1 is above m2 and m3, and all five controllers fail."""
    usual = ["vehicle={beta_udot: -6 kg, beta_vdot: -1.1 kg, beta_wdot: -1.15 kg}"]
    loop, warning = analyse(load_scenario("paper", usual)).warnings
    assert loop.startswith("the linear loop is unstable at every gain")
    assert warning.startswith("vehicles 1, 2, 3, 4: the surge inertia m1")


RNG = np.random.default_rng(3)


def chain(n: int, ahead: float, behind: float) -> Any:
    A = np.diag(np.full(n - 1, ahead), -1) + np.diag(np.full(n - 1, behind), 1)
    return np.diag(A.sum(axis=1) + 1.0) - A


def ring(n: int, ahead: float, behind: float) -> Any:
    A = np.roll(np.eye(n), -1, axis=1) * ahead + np.roll(np.eye(n), 1, axis=1) * behind
    return np.diag(A.sum(axis=1) + 1.0) - A


TWO = np.kron(np.eye(2), chain(5, 1.0, 0.8))  # two graphs that are not connected


@pytest.mark.parametrize(
    ("M", "real"),
    [
        (chain(8, 1.0, 0.8), True),
        (TWO, True),
        (ring(6, 1.0, 1.0), True),
        (ring(6, 1.0, 0.8), False),  # against the cycle the weights are others
        (chain(6, 1.0, 0.0), False),  # one way only
        (np.zeros((3, 3)), True),
        (RNG.uniform(0.1, 1.0, (7, 7)), False),
    ],
)
def test_like_the_general_method(M: Any, real: bool) -> None:
    found = eigenvalues(M)
    assert np.isrealobj(found) == real or not np.iscomplexobj(np.linalg.eigvals(M))
    assert np.allclose(np.sort_complex(found), np.sort_complex(np.linalg.eigvals(M)), atol=1e-9)


def test_a_long_chain_has_no_imaginary_parts() -> None:
    """The general method gives 1,000 vehicles eigenvalues such as 4.595+0.000475i."""
    found = eigenvalues(chain(400, 1.0, 0.8))
    assert np.isrealobj(found)
    assert found.min() == pytest.approx(1.0)
    assert found.max() < 2.8 + 2.0 * np.sqrt(0.8)


def test_a_moored_fleet_has_no_loop() -> None:
    """Eigenvalues, limits and a reference that every vehicle follows were told of vehicles that stay where they are."""
    scenario = load_scenario("election", ["moored=true"])
    assert report(scenario, analyse(scenario)) == ["graph: connected; the vehicles are moored"]
