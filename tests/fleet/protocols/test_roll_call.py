"""The roll call: what it keeps, and that only a nemesis that never heals stops it."""

from __future__ import annotations

import pytest
from marks import slow

from fleet.execution.whole_run import run

SHORT = [
    "vehicles=3",
    "agent.parameters.vehicles=3",
    "duration=12 s",
    "tick=20 ms",
    "expect=pass",
    "checks={tumbled: waived, signal: {name: goes-on, topic: control.waiting, below: 2 s, eventually_within: 2 s, "
    "for_at_least: 1 s, after: 9 s}}",
]


@pytest.mark.parametrize(
    ("mode", "quorum", "seed", "passes"),
    [
        *slow(("swarm", "all", 1, True), ("swarm", "all", 2, True)),
        ("liveness", "all", 1, False),
        ("liveness", "majority", 1, True),
    ],
)
def test_only_a_fault_that_never_ends_stops_those_who_wait_for_all(
    mode: str, quorum: str, seed: int, passes: bool
) -> None:
    """docs/guide/protocols/roll_call.md says how many seeds the shipped scenario was run with; these are short ones."""
    changes = [f"nemesis.mode={mode}", f"agent.parameters.quorum={quorum}"]
    result = run("roll-call", set=[*SHORT, *changes], seed=seed)
    (goes_on,) = (verdict for verdict in result.checks if verdict.check == "goes-on")
    assert goes_on.passed is passes, goes_on.found
