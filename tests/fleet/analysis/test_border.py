"""The limits of the linear loop: against the eigenvalues of its matrix, and against the simulation."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from repository import ROOT

from fleet.analysis.border import FINE, SLOW, LinearFleet, linear_fleet
from fleet.analysis.linear import Linear, Link, Member, NotLinear, VehicleRound
from fleet.analysis.stability import analyse, report
from fleet.scenario.loading import load_scenario

sys.path.insert(0, str(ROOT / "docs" / "examples"))
from stability_borders import Case, delay_row, gain_row, line

PAPER = linear_fleet(load_scenario("paper"), [(1.0, 1.0, 1.0)] * 4).members[0].linear


def eigenvalues(fleet: LinearFleet, gain: float) -> np.ndarray:
    """Of the map over one round, made tick by tick from the states and every output of the last ticks."""
    members, m = fleet.members, fleet.m
    n = len(members[0].linear.F)
    kept = m + max(link.delay for member in members for link in member.links) + 1  # ticks of y
    block = n + 6 * kept  # of one vehicle: s, then y of this tick, of the one before and so on
    N = len(members)
    total = np.eye(N * block)
    for phase in range(m):
        # y of this tick is known before the laws run; what was kept moves one place on.
        keep, step = np.zeros((N * block, N * block)), np.eye(N * block)
        for i, member in enumerate(members):
            F, G, C = member.linear
            at = i * block
            keep[at : at + n, at : at + n] = np.eye(n)
            keep[at + n : at + n + 6, at : at + n] = C
            for k in range(1, kept):
                old, new = at + n + 6 * (k - 1), at + n + 6 * k
                keep[new : new + 6, old : old + 6] = np.eye(6)
            K = gain * member.pattern
            step[at : at + n, at : at + n] = F + member.c * G @ K @ C[:3]
            for link in member.links:
                age = next(a for a in range(link.delay, link.delay + m) if (phase - a) % m == 0)
                capped = age if member.age_cap is None else min(age, member.age_cap)
                read = np.hstack([np.eye(3), (capped * fleet.tick_s if member.reckons else 0.0) * np.eye(3)])
                there = link.sender * block + n + 6 * age
                if not member.told:
                    step[at : at + n, there + 3 : there + 6] -= link.weight * G / (member.c - member.b)
                step[at : at + n, there : there + 6] -= link.weight * G @ K @ read
        total = step @ keep @ total
    return np.linalg.eigvals(total)


@st.composite
def fleets(draw: st.DrawFn) -> LinearFleet:
    """Two or three vehicles of the paper with any links between them."""
    n = draw(st.integers(2, 3))
    members = []
    for i in range(n):
        links = tuple(
            Link(j, draw(st.sampled_from([0.5, 1.0, 1.0])), draw(st.integers(1, 7)))
            for j in range(n)
            if j != i and draw(st.booleans())
        )
        cap = draw(st.sampled_from([None, 3]))
        told = draw(st.booleans())
        members.append(Member(PAPER, 1.0, links, draw(st.booleans()), cap, np.diag([1.0, 0.7, 0.9]), told))
    assume(any(member.links for member in members))
    return LinearFleet(tuple(members), draw(st.integers(1, 5)), 0.04)


# A zero of its determinant leaves the circle at 0.34 Hz, beside a pole that stays inside. Between two angles that were
# looked at the determinant made a whole turn, so the border was told 6 % too high.
POLE_BESIDE_ZERO = LinearFleet(
    tuple(Member(PAPER, 1.0, (Link((i + 1) % 3, 0.5, 1),), False, None, np.diag([1.0, 0.7, 0.9])) for i in range(3)),
    1,
    0.04,
)


@pytest.mark.filterwarnings("ignore:Generating overly large repr")  # of a large matrix
@given(fleets(), st.floats(0.2, 5.0))
@example(POLE_BESIDE_ZERO, 4.8)
def test_as_many_modes_grow_as_the_matrix_has_eigenvalues_outside(fleet: LinearFleet, gain: float) -> None:
    """The turns of the determinant count the eigenvalues: hold, rounds, delays, caps and double zeros included."""
    sizes = np.abs(eigenvalues(fleet, gain))
    assume(np.abs(sizes - 1.0).min() > 1e-5)
    assert fleet.unstable(gain) == int((sizes > 1.0).sum())


def test_a_chain_needs_no_determinant(monkeypatch: pytest.MonkeyPatch) -> None:
    """`fleet check rough-sea` took four times as long: it went through 200 delays, and none of them matters."""
    monkeypatch.setattr(np.linalg, "slogdet", None)
    fleet = analyse(load_scenario("rough-sea")).at_most
    assert fleet.delay_border(0.3) is None
    assert fleet.gain_border(0.3) == pytest.approx(8.39, rel=0.01)


def test_equal_vehicles_have_multiple_zeros() -> None:
    """On the complete graph of four all modes but one come three times."""
    links = [tuple(Link(j, 1.0, 2) for j in range(4) if j != i) for i in range(4)]
    fleet = LinearFleet(tuple(Member(PAPER, 1.0, own, True, None, np.eye(3)) for own in links), 3, 0.01)
    for gain in (1.0, 1.65, 3.0):
        sizes = np.abs(eigenvalues(fleet, gain))
        assert fleet.unstable(gain) == int((sizes > 1.0).sum())


@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@given(fleets())
@example(POLE_BESIDE_ZERO)
@settings(max_examples=8)
def test_the_mode_at_the_border_is_the_eigenvalue_that_leaves_the_circle(fleet: LinearFleet) -> None:
    """Whether vehicles excite each other, or one of them grows by itself."""
    gain = fleet.gain_border(1.0)
    assume(0.0 < gain < float("inf"))
    found = eigenvalues(fleet, gain * (1.0 + FINE))
    slow = SLOW * fleet.m * fleet.tick_s
    outside = [abs(np.angle(z)) for z in found if abs(z) > 1.0 and abs(np.angle(z)) > slow]
    assume(outside)
    frequencies = np.array(outside) / (2.0 * np.pi * fleet.m * fleet.tick_s)
    assert np.abs(frequencies - fleet.mode(gain).frequency_hz).min() < 0.1


def test_a_vehicle_that_grows_by_itself_is_named() -> None:
    """`follow-the-leader` was said to grow in the speed loop at 2.7 Hz, the nearest point of a determinant that has no
    zero there."""
    fleet = analyse(load_scenario("follow-the-leader")).at_most
    mode = fleet.mode(fleet.gain_border(0.3))
    assert (mode.loop, round(mode.frequency_hz, 1)) == ("course", 1.6)


@pytest.mark.parametrize("defective", [False, True])
def test_the_resolvent_is_that_of_a_linear_system(defective: bool) -> None:
    """Also if eigenvalues meet, and their vectors do not span the space."""
    kind = VehicleRound(Member(PAPER, 1.0, (Link(1, 1.0, 1),), True, None, np.eye(3)), 0.8, 5, 0.04, 6)
    if defective:
        n = len(PAPER.F)
        kind = VehicleRound(
            Member(Linear(0.9 * np.eye(n) + np.eye(n, k=1), PAPER.G, PAPER.C), 1.0, (), True, None, np.zeros((3, 3))),
            0.8,
            1,
            0.04,
            6,
        )
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    each = np.array([PAPER.C @ np.linalg.inv(one * np.eye(len(kind._P)) - kind._P) for one in z])
    assert kind.resolvent(z, np.eye(len(kind._P))) == pytest.approx(each, rel=1e-6, abs=1e-9 * np.abs(each).max())


def test_a_division_by_zero_that_changes_no_result_is_no_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """numpy's determinant of a regular complex matrix makes one on arm64."""
    divisions = 0

    def on_arm64(part: np.ndarray) -> object:
        nonlocal divisions
        divisions += int(np.isnan(np.array([0.0, 1.0]) / 0.0).sum())
        return slogdet(part)

    slogdet = np.linalg.slogdet
    monkeypatch.setattr(np.linalg, "slogdet", on_arm64)
    link = Link(1, 1.0, 2), Link(0, 1.0, 2)
    fleet = LinearFleet(tuple(Member(PAPER, 1.0, (own,), True, None, np.eye(3)) for own in link), 3, 0.01)
    assert fleet.unstable(1.0) == 0
    assert fleet.mode(1.0).frequency_hz > 0
    assert divisions


@pytest.mark.parametrize(
    ("what", "case", "seconds"),
    [
        ("gain", Case("path", 10, 1.0), 8.0),
        pytest.param("gain", Case("star", 200, 1.0), 40.0, marks=pytest.mark.slow),
        pytest.param("gain", Case("ring", 100, 1.0, 0, "reference"), 40.0, marks=pytest.mark.slow),
        pytest.param("delay", Case("ring", 100, 0.9), 40.0, marks=pytest.mark.slow),
    ],
)
def test_the_simulation_decays_below_the_limit_and_grows_above(what: str, case: Case, seconds: float) -> None:
    """5 % below and above the computed border; docs/background/linear-stability.md has some of the rows."""
    found = gain_row(case, seconds) if what == "gain" else delay_row(case, seconds)
    assert found.holds, line(found)


@pytest.mark.parametrize(
    ("graph", "thumb", "simulated"),
    [
        ("{shape: path, behind: 0.8}", 2.460, 2.094),
        ("{shape: ring, behind: 0.8}", 2.165, 1.847),
        ("{edges: {'1->2': 1, '2->3': 1, '3->4': 1}}", 5.0, 4.00),  # grows along the chain before it decays
    ],
)
def test_the_rule_of_thumb_is_optimistic(graph: str, thumb: float, simulated: float) -> None:
    """K lambda_max < a promises 18 to 25 % more than there is; simulated independently, with messages at every tick."""
    found = analyse(load_scenario("ideal", [f"graph={graph}", "controller=nbc"]))
    assert 10.0 / found.lambda_max == pytest.approx(thumb, rel=5e-3)
    assert found.at_most.gain_border(2.0) == pytest.approx(simulated, rel=0.05)


def test_a_gain_that_the_rule_of_thumb_accepts_is_warned_of() -> None:
    """K0 = 2.3 1/s was called below a, and the fleet was lost."""
    scenario = load_scenario("paper", ["controller=nbc", "guidance.K0=2.3 2.3 2.3 1/s"])
    found = analyse(scenario)
    (warning,) = found.warnings
    assert warning.startswith(
        "K is 2.3 1/s, above the limit of the linear loop. With these rounds and delays the limit is 1.9"
    )
    assert "Above it the course loop oscillates at 1.6 Hz and grows" in warning
    text = "\n".join(report(scenario, found))
    assert "Here K is 2.3 1/s: UNSTABLE" in text
    assert "K lambda_max(L+B) < a: kept. 2.3 x 4.065 = 9.349 1/s, and a = 10 1/s" in text


def test_a_delay_that_the_rule_of_thumb_accepts_is_warned_of() -> None:
    """K tau rho(A) = 0.686 was called below 1, and the run ended 220 m off."""
    slow = ["controller=nbc", "guidance.K0=0.9 0.9 0.9 1/s", "network.links={'*': 'delay 430ms'}"]
    scenario = load_scenario("paper", slow)
    found = analyse(scenario)
    text = "\n".join(report(scenario, found))
    assert "K tau rho(A) < 1: kept. 0.9 1/s x 0.52 s x 1.447 = 0.6773" in text
    assert "the longest delay here: 0.43 s" in text
    (warning,) = found.warnings
    assert "above the limit of the linear loop" in warning
    assert analyse(load_scenario("paper", [*slow, "neighbours.extrapolate=reference"])).warnings == []


def test_what_a_gain_that_is_optimised_bears() -> None:
    """The paper's fleet holds with 250 ms and not with 300 ms, in simulation as in `fleet check`."""
    scenario = load_scenario("paper")
    found = analyse(scenario)
    assert found.settled == pytest.approx((0.3, 0.3, 1.171), abs=1e-3)
    assert 0.25 <= 0.01 * (found.at_settled.delay_border(max(found.settled or ())) or 0) <= 0.30
    assert "2 1/s at most: unstable if it stays so large" in "\n".join(report(scenario, found))


@pytest.mark.parametrize(
    ("overrides", "why"),
    [
        (["vehicles=21", "graph={shape: ring}", "formation={shape: grid}", "initial={scatter: 1 m}"], "more than 20"),
        (["network={period: 1 s, payload: compact, acoustic: mfsk-1066}"], "acoustic"),
        (["reference.velocity=0.2 0 0 m/s"], "no steady flight at 0.2 m/s"),
        (["neighbours.drop_after=50 ms"], "drop_after"),
        (["graph={edges: {'1->2': 1}, reference: [1]}"], "not every vehicle is reached"),
    ],
)
def test_where_there_is_no_linear_loop(overrides: list[str], why: str) -> None:
    """Then `fleet check` says why, and tells the rules of thumb alone."""
    scenario = load_scenario("paper", overrides)
    found = analyse(scenario)
    text = "\n".join(report(scenario, found))
    assert "limits of the linear loop: not computed" in text
    assert why in text


def test_it_is_the_same_on_every_course_and_in_a_current() -> None:
    """The loop does not know north from south; and a current as fast as a tenth of the speed moves the limit little."""
    borders = []
    for velocity in ("0.7 0.1 0", "-0.7071 0.0001 0", "0 -0.7071 0"):
        scenario = load_scenario("paper", ["controller=nbc", f"reference.velocity={velocity} m/s"])
        borders.append(linear_fleet(scenario, [(1.0, 1.0, 1.0)] * 4).gain_border(2.0))
    assert borders == pytest.approx([borders[0]] * 3, rel=5e-3)
    drifting = load_scenario("paper", ["controller=nbc", "sea.current=0 0.07 0 m/s"])
    assert linear_fleet(drifting, [(1.0, 1.0, 1.0)] * 4).gain_border(2.0) == pytest.approx(borders[0], rel=0.05)


def test_a_law_that_is_not_ours_has_no_linear_loop() -> None:
    with pytest.raises(NotLinear, match="vehicle 2 runs a law"):
        linear_fleet(load_scenario("paper"), [(1.0, 1.0, 1.0), None, None, None])


def test_who_does_not_know_the_trajectory_goes_by_the_velocities_that_it_hears() -> None:
    """Simulated: path, rounds of 100 ms, K = 0.3 decays to 1e-7 m within a minute."""
    scenario = load_scenario(
        "paper", ["controller=nbc", "guidance.K0=0.3 0.3 0.3 1/s", "graph.reference=[1]", "knows_reference=false"]
    )
    fleet = analyse(scenario).at_most
    assert [member.told for member in fleet.members] == [True, False, False, False]
    assert fleet.unstable(0.3) == 0


def test_of_vehicles_with_equations_of_their_own_nothing_linear_is_said() -> None:
    """By the numbers of their model the loop of this fleet would grow and its angles be unstable; it flies."""
    scenario = load_scenario("remus")
    found = analyse(scenario)
    assert found.not_linear == "vehicle 1 is the plant remus100, which has equations of its own"
    assert found.at_settled is None
    assert found.warnings == []


def test_long_delays_are_not_computed_and_that_is_said() -> None:
    at, beyond = (load_scenario("paper", [f"network.links.*.delay={delay}"]) for delay in ("4.9s", "5.1s"))
    assert linear_fleet(at, [(1.0, 1.0, 1.0)] * 4).members
    found = analyse(beyond)
    assert found.at_most is None
    assert "a message takes up to 5.1 s; for 4 vehicles they are computed up to 5 s" in "\n".join(report(beyond, found))


def test_each_step_of_a_long_computation_is_told() -> None:
    steps: list[int] = []
    scenario = load_scenario("paper")
    found = analyse(scenario, on_progress=lambda: steps.append(1))
    first = len(steps)
    assert first > 0
    report(scenario, found)
    assert len(steps) > first + 10
