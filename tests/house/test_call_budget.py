"""How much work a tick is, counted in calls and messages: the guard against slips that a noisy machine hides.

A count is the same on every machine, so a rise is a change of the code. `WRITE_CALLS=1 pytest` with this file writes
tests/expected/calls.json anew; a budget that grows is a decision, so its commit says why.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from counted_calls import by_room, counted_apart
from marks import slow
from repository import EXPECTED

from fleet.cores import cores

BUDGET = EXPECTED / "calls.json"
MARGIN = 0.10
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
WRITE = "WRITE_CALLS=1 pytest tests/house/test_call_budget.py"


def judged(name: str, budget: dict[str, float], found: dict[str, float]) -> list[str]:
    """What to say about a fleet's calls by module: rooms that are off by more than the margin, and their modules."""
    rooms, before, lines = by_room(found), by_room(budget), []
    for room in sorted(rooms.keys() | before.keys()):
        now, allowed = rooms.get(room, 0.0), before.get(room, 0.0)
        if abs(now - allowed) <= MARGIN * allowed:
            continue
        more = {
            module: found.get(module, 0.0) - budget.get(module, 0.0)
            for module in found.keys() | budget.keys()
            if by_room({module: 1.0}) == {room: 1.0}
        }
        worst = sorted(more.items(), key=lambda item: -abs(item[1]))[:3]
        changes = ", ".join(f"{module} {change:+.1f}" for module, change in worst)
        what = "above the budget" if now > allowed else f"below it: lower the budget with {WRITE}"
        share = f"{abs(now / allowed - 1):.0%} " if allowed else ""
        lines.append(f"{name}, {room}: {now:.1f} calls per tick, {share}{what} ({allowed:.1f}); {changes}")
    return lines


@pytest.mark.skipif(cores() == "compiled", reason="calls of compiled functions are not seen")
@pytest.mark.parametrize("vehicles", [4, *slow(20)])
def test_a_tick_takes_no_more_calls_and_messages_than_it_did(vehicles: int, tmp_path: Path) -> None:
    calls, messages = counted_apart(vehicles, tmp_path)
    name = f"N = {vehicles}"
    document: dict[str, Any] = json.loads(BUDGET.read_text("utf-8")) if BUDGET.exists() else {}
    if os.environ.get("WRITE_CALLS"):
        rounded = {module: round(number, 2) for module, number in sorted(calls.items()) if number}
        document |= {"python": PYTHON, name: {"calls": rounded, "messages": messages}}
        BUDGET.write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    budget = document[name]
    assert messages == budget["messages"], f"messages per tick changed; if this is meant: {WRITE}"
    lines = judged(name, budget["calls"], calls)
    if document["python"] != PYTHON:  # a newer one calls less for the same code
        lines = [line for line in lines if "above" in line]
    assert lines == [], "\n".join(lines)


def test_a_rise_and_a_fall_are_told_with_the_modules_that_changed() -> None:
    budget = {"agents.agent": 60.0, "agents.brain": 40.0, "world.sea": 100.0}
    assert judged("N = 4", budget, {**budget, "agents.brain": 49.0}) == []
    (line,) = judged("N = 4", budget, {**budget, "agents.brain": 61.0, "agents.new": 2.0})
    assert line == (
        "N = 4, agents: 123.0 calls per tick, 23% above the budget (100.0); "
        "agents.brain +21.0, agents.new +2.0, agents.agent +0.0"
    )
    (line,) = judged("N = 4", budget, {**budget, "world.sea": 50.0})
    assert line.startswith("N = 4, world: 50.0 calls per tick, 50% below it: lower the budget with WRITE_CALLS=1 ")
    (line,) = judged("N = 4", budget, {**budget, "netem.network": 5.0})
    assert line == "N = 4, netem: 5.0 calls per tick, above the budget (0.0); netem.network +5.0"
