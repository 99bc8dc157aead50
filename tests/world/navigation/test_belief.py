"""What an agent is told of itself is what its vehicle believes, and nothing of the truth reaches it."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from in_process_runs import Alone, log_of

from fleet.execution.whole_run import run
from fleet.logs.open_log import open_log
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Fix, VehicleFrame
from netem.wire.parts import PART_BYTES
from world.navigation.config import NavigationTrace, TracePoint
from world.navigation.navigator import MOST_TOLD
from world.navigation.trace_replay import ReplayedError
from world.process import _row_bytes

FAULTS = "faults=[{at: 500 ms, for: 1 s, fix: {lost: 50 %}}]"
SHORT = ["duration=2 s", "checks={}", "navigation.tilt=1 deg", FAULTS]


def test_an_agent_does_what_it_would_do_if_the_belief_were_true() -> None:
    """The agents' configuration is the same with and without navigation: they have no other source."""
    navigating = load_scenario("dead-reckoning")
    ideal = load_scenario("dead-reckoning", ["navigation=ideal", "per_vehicle={}", "checks={}"])
    assert all(navigating.agent_config(i) == ideal.agent_config(i) for i in range(1, 5))


def test_the_log_has_truth_and_belief(alone: Alone) -> None:
    log = open_log(log_of(alone("dead-reckoning", "duration=9 s", "checks={}", "per_vehicle.2.navigation=ideal")))
    belief, state, nav, error = (log[f"uuv/1/{group}"] for group in ("belief", "state", "nav", "error"))
    off = np.column_stack([nav.x, nav.y, nav.z]) - np.column_stack([state.x, state.y, state.z])[:-1]
    assert belief.off == pytest.approx(off)
    assert belief.formation == pytest.approx(error.formation[:-1] + off)
    assert belief.sd[:, 0] ** 2 == pytest.approx(belief.covariance[:, 0])
    assert belief.units["sd"] == "m"
    fix = log["uuv/1/fix"]
    assert [*fix.source] == ["usbl"] * len(fix)
    assert [*fix.measured] == [5.0]
    assert [*fix.t] == [6.0]
    before, after = (belief.sd[np.searchsorted(belief.t, at), 0] for at in (5.95, 6.05))
    assert after < before
    assert "uuv/2/belief" not in log and "uuv/2/fix" not in log
    assert not len(log["uuv/3/fix"])


def test_a_replayed_error_is_that_of_the_trace() -> None:
    """Linear between its points, constant outside; the velocity is that of the belief."""
    points = TracePoint(1.0, 1.0, 0.0, 0.0), TracePoint(3.0, 5.0, -2.0, 1.0, 0.2)
    replayed = ReplayedError(NavigationTrace(points), 10**9)
    truth = (10.0, 20.0, 30.0, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0)
    found = []
    for _ in range(5):
        found.append(replayed.belief(truth, ()))
        replayed.step(truth, truth, (0.0, 0.0, 0.0), (), 0.0)
    places = [(11.0, 20.0, 30.0), (11.0, 20.0, 30.0), (13.0, 19.0, 30.5), (15.0, 18.0, 31.0), (15.0, 18.0, 31.0)]
    assert np.array([eta[:3] for eta, _, _ in found]) == pytest.approx(np.array(places))
    assert found[2][1][:3] == pytest.approx((2.7, -1.0, 0.5))
    assert found[2][0][4] == pytest.approx(0.1)
    assert replayed.covariance() == ()


def test_a_row_with_fixes_is_not_longer_than_it_is_counted() -> None:
    """Frames are split by this count; a part that is too long would be lost on the way."""
    fix = Fix("usbl", 2**63, 2**63, (1.1, 2.2), 3.3, 4.4, True)
    row = VehicleFrame(1, (0.1,) * 5, (0.1,) * 5, (0.1,) * 12, (0.1,) * 3, b"", (), (), (0.1,) * 10, (fix,) * MOST_TOLD)
    assert len(msgspec.msgpack.encode(row)) <= _row_bytes(row) < PART_BYTES


@pytest.mark.parametrize(
    "fault", ["compass: {bias: 1e308 deg}", "dvl: {bias: 1e308 0 0 m/s}", "fix: {bias: 1e308 0 m}"]
)
def test_an_absurd_fault_ends_a_vehicle_and_not_the_world(fault: str) -> None:
    """With an error in words, or, as a fix that is refused, not at all."""
    found = run(load_scenario("dead-reckoning", [*SHORT[:3], f"faults=[{{at: 200 ms, {fault}}}]", "on_death=continue"]))
    assert found.values["sim_s"] == 2.0
