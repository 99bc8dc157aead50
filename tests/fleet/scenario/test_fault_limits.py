"""The limits of a nemesis: what is drawn and what a guided search makes of it keep to the same ones."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest
from small_scenario import only_problem, small

from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.ground import FaultLimits
from fleet.scenario.sections.timeline import action, vehicles_of
from fleet.study.moves import Draws, Mutator
from fleet.study.shrink import tree_of

S = 10**9
SWARM = ("duration=60 s", "vehicles=5", "graph={shape: ring}")
ONE = "nemesis={mode: swarm, pick: [kill, mute, down], mean: 2 s, most_silent: 1}"


def fault(at: str, **more: str) -> FaultSection:
    return FaultSection.model_validate({"at": at, **more})


def silent_at_once(scenario: Scenario) -> int:
    """The most vehicles that are silent at a time."""
    spells = [
        (one.at, one.at + (one.for_ or scenario.duration_ns), vehicles_of(one))
        for one in scenario.spec.faults
        if action(one) in ("kill", "mute", "pause")
    ]
    return max((len({i for a, b, who in spells if a <= at < b for i in who}) for at, _, _ in spells), default=0)


def test_what_goes_beyond_is_left_out() -> None:
    faults = [fault("1 s", kill="1", **{"for": "4 s"}), fault("2 s", mute="1", **{"for": "1 s"}),
              fault("3 s", kill="2", **{"for": "9 s"}), fault("4 s", down="1->2"), fault("5 s", pause="3")]  # fmt: skip
    assert FaultLimits().kept(faults) == [True] * 5
    assert FaultLimits(1).kept(faults) == [True, True, False, True, True]  # of the same vehicle; after the first
    assert FaultLimits(2).kept(faults) == [True, True, True, True, True]
    assert FaultLimits(1).kept(faults, [fault("0 s", kill="5")]) == [False, False, False, True, False]
    assert FaultLimits(start_ns=2 * S, every_ns=2 * S).kept(faults) == [False, True, False, True, False]


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_seed_and_a_guide_keep_to_them(seed: int) -> None:
    free = [small(*SWARM, ONE, "nemesis.most_silent=5", f"seed={n}") for n in range(seed, seed + 6)]
    kept = [small(*SWARM, ONE, f"seed={n}") for n in range(seed, seed + 6)]
    assert max(map(silent_at_once, free)) > 1 and max(map(silent_at_once, kept)) == 1
    lists = [tree_of(scenario).get("faults") or [] for scenario in free]  # more than the guide may make of them
    for key in range(20):
        tree = {**tree_of(kept[0]), "faults": Mutator(kept[0], 45 * S).mutated(lists[0], lists, None, Draws(key))}
        assert silent_at_once(parse_scenario(json.dumps(tree), "moved")) <= 1


def test_on_a_grid_a_guide_moves_faults_no_nearer_and_makes_none_longer() -> None:
    grid = "nemesis={every: 8 s, for: 4 s, until: 44 s, pick: [kill, down, {wrench: {vehicles: 1, force: 9 0 0 N}}]}"
    scenarios = [small(*SWARM, grid, f"seed={n}") for n in range(1, 5)]
    lists = [tree_of(scenario)["faults"] for scenario in scenarios]
    shifted = False
    for key in range(60):
        faults = Mutator(scenarios[0], 44 * S).mutated(lists[0], lists, 20 * S, Draws(key))
        moved = parse_scenario(json.dumps({**tree_of(scenarios[0]), "faults": faults}), "moved").spec.faults
        begins = [one.at for one in moved]
        shifted = shifted or any(at % (8 * S) for at in begins)
        assert all(one.for_ is not None and one.for_ <= 4 * S for one in moved)
        assert min(begins, default=8 * S) >= 8 * S
        assert all(b - a >= 8 * S for a, b in pairwise(begins))
        assert all(one.wrench is None or one.wrench.force == (9.0, 0.0, 0.0) for one in moved)  # never stronger
    assert shifted


def test_liveness_has_limits_of_its_own() -> None:
    assert "name a core" in only_problem(*SWARM, "nemesis={mode: liveness, most_silent: 1}")
