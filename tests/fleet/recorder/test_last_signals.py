"""The last signals of an agent are in the result, unless it ended before the run."""

from __future__ import annotations

import pytest

from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import parse_scenario

AVERAGE = """
title: average
moored: true
vehicles: 3
duration: 2 s
graph: {shape: ring}
agent: {law: "fleet.protocols.average:ExactAverage"}
network: {period: 100 ms}
checks: {ledger: balanced}
"""


@pytest.mark.parametrize("ticks", range(2, 24))
def test_they_are_there_whatever_the_duration_is(ticks: int) -> None:
    """As seconds, half of these durations had no signals: 0.3 s less 0.2 s is more than 0.1 s."""
    result = run_loaded(parse_scenario(AVERAGE, "a.yaml", [f"duration={100 * ticks} ms"]))
    assert all(row["signals"] for row in result.values["vehicles"].values())


def test_who_ended_before_has_none() -> None:
    result = run_loaded(parse_scenario(AVERAGE, "a.yaml", ["faults=[{at: 1 s, kill: 2}]", "checks.deaths=waived"]))
    assert [bool(row["signals"]) for row in result.values["vehicles"].values()] == [True, False, True]
