"""A run in one process: what ends it is what came first in simulated time."""

from __future__ import annotations

from collections.abc import Callable

from failing_laws import module as module

from fleet.execution.whole_run import run
from fleet.result.result import Status

FAILS = """\
class Law:
    signals = ()
    def __init__(self, config):
        self.config = config
    def step(self, sample):
        if sample.tick == {1: 37, 3: 33}.get(self.config.id):
            raise RuntimeError("no")
        return (1.0, 0.0, 0.0), {}
"""


def test_the_first_failure_in_simulated_time_ends_the_run(module: Callable[[str], str]) -> None:
    """Agent 1 is the first that goes on to the next round, at tick 40, and fails after agent 3."""
    found = run("paper", set={"controller": f"{module(FAILS)}:Law", "duration": "1 s", "checks": {}})
    assert found.status is Status.BROKEN
    assert "agent 3" in found.reason
    assert "0.33 s" in found.reason or "tick 33" in found.reason
