"""A vehicle that goes stern first comes back to its place, whichever law steers it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from in_process_runs import recorded
from loops import Nav, agent_config
from marks import slow
from repository import ROOT

from agents.laws.kinematics import earth_velocity
from agents.offset import Offset
from agents.sample import Sample, VelocityCommand
from agents.trajectory import Motion
from fleet.addons.templates import agent, controller, tracking
from fleet.result.result import Result

sys.path.insert(0, str(ROOT / "docs" / "examples"))
from leader_follower import LeaderFollower

START = "initial={scatter: 0.5 m, surge: -0.6 m/s}"
IN_PLACE = "checks={formation_error: {below: 0.5 m, after: 30 s}}"
LAWS = {
    **{name: f"controller={name}" for name in ("nboc", "nbc", "boc", "bc", "bsmc")},
    "exact angles": "tracking.angles=exact",
}
QUICK = ("nboc",)


def in_place(result: Result) -> bool:
    (check,) = [check for check in result.checks if check.check == "formation_error"]
    return check.passed


@pytest.mark.parametrize("law", [*QUICK, *slow(*(law for law in LAWS if law not in QUICK))])
def test_a_vehicle_that_begins_astern_comes_to_its_place(law: str, tmp_path: Path) -> None:
    result = recorded(tmp_path, "paper", START, IN_PLACE, LAWS[law], "duration=30 s", "log.every=50 ticks")
    assert in_place(result), result.checks


def test_the_law_as_printed_leaves_its_depth(tmp_path: Path) -> None:
    """Below u = 0 the pitch of the velocity falls as the bow rises. The paper's own results need this way."""
    result = recorded(
        tmp_path, "paper", START, IN_PLACE, "tracking.astern=printed", "duration=30 s", "log.every=50 ticks"
    )
    assert not in_place(result)


ETA, NU = (0.0, 0.0, 0.0, 0.3, 0.0), (-0.5, 0.0, 0.0, 0.0, 0.0)  # the bow points up, so the vehicle sinks astern
AHEAD = Motion((0.0, 0.0, 0.0), (0.7, 0.0, 0.0))
SAMPLE = Sample(0, 0.0, 0.01, ETA, NU, earth_velocity(ETA, NU), AHEAD, (), (0.0, 0.0, 0.0), 1.0, "")
MOMENTS = {
    "template of a tracking law": lambda config: tracking.TheLaw(config).step(SAMPLE, VelocityCommand(0.7, 0.0, 0.0)),
    "template of a controller": lambda config: controller.TheLaw(config).step(SAMPLE),
    "template of an agent": lambda config: agent.TheLaw(config).decide(Nav(0, ETA, NU), []),
    "example": lambda config: LeaderFollower(config).step(SAMPLE),
}


@pytest.mark.parametrize("law", MOMENTS)
def test_a_law_of_ours_to_copy_lowers_the_bow_of_a_vehicle_that_sinks_astern(law: str) -> None:
    """To go level, ahead. They lifted it, because the velocity points down."""
    (surge, pitch, _), _ = MOMENTS[law](replace(agent_config(1), offset=Offset((0.0, 0.0, 0.0))))
    assert surge > 0.0
    assert pitch < 0.0
