"""The verdict on how punctual a run on a wall clock was."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from fleet.analysis import punctuality as timing

FINE: dict[str, Any] = {
    "world": {"period_ms": 10.0, "slipped_s": 0.0, "held_s": 0.0, "run_s": 10.0},
    "vehicles": {
        "1": {"asked": 1000, "missed": 0, "longest": 0, "silent": 0},
        "2": {"asked": 1000, "missed": 0, "longest": 0, "silent": 0},
    },
    "netem": {"late": {"1": 0}, "missed": {"1": 0}, "overdue": 0, "hop": {"count": 100}},
}


def worse(path: str, value: Any) -> dict[str, Any]:
    changed = json.loads(json.dumps(FINE))
    *most, last = path.split(".")
    place = changed
    for step in most:
        place = place[step]
    place[last] = value
    return changed


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (
            "vehicles.2",
            {"asked": 1000, "missed": 8, "longest": 3, "silent": 0},
            r"agent 2 missed 8 of 1000 ticks \(0.80%\), 3 in",
        ),
        ("vehicles.1.silent", 120, r"agent 1 was silent for 1.2 s in all, suspended or stuck$"),
        ("netem.late", {"1": 3}, "3 transmissions"),
        ("netem.missed", {"1": 1}, "1 transmissions"),
        ("netem.overdue", 7, "7 of 100 deliveries"),
        ("world.slipped_s", 0.05, "moved the clock by 0.05 s"),
        ("world.held_s", 2.0, "stood still for 2 s"),
    ],
)
def test_whatever_is_late_degrades_a_run_and_is_named(path: str, value: Any, said: str) -> None:
    assert timing.label(FINE) == ("on time", [])
    name, reasons = timing.label(worse(path, value))
    assert (name, len(reasons)) == ("degraded", 1)
    assert re.search(said, reasons[0])


def test_the_verdict_tolerates_what_was_asked_for() -> None:
    some = worse("vehicles.2", {"asked": 1000, "missed": 8, "longest": 3, "silent": 0})
    assert timing.verdict(some, 0.01).passed
    assert not timing.verdict(some, 0.005).passed
    assert timing.verdict(some, 0.01).found.startswith("degraded: agent 2 missed")
    assert not timing.verdict(worse("world.slipped_s", 1.0), 0.01).passed
