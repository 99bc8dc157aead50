"""The limit of a nemesis: so many vehicles are silent at once, at most."""

from __future__ import annotations

from small_scenario import small

from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.nemesis import within_limit
from fleet.scenario.sections.timeline import action, vehicles_of

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

    def kept(most: int | None, *own: FaultSection) -> list[bool]:
        left = within_limit(most, faults, own)
        return [one in left for one in faults]

    assert kept(None) == [True] * 5
    assert kept(1) == [True, True, False, True, True]  # of the same vehicle; after the first
    assert kept(2) == [True, True, True, True, True]
    assert kept(1, fault("0 s", kill="5")) == [False, False, False, True, False]


def test_a_seed_keeps_to_it() -> None:
    free = [small(*SWARM, ONE, "nemesis.most_silent=5", f"seed={n}") for n in range(1, 10)]
    kept = [small(*SWARM, ONE, f"seed={n}") for n in range(1, 10)]
    assert max(map(silent_at_once, free)) > 1 and max(map(silent_at_once, kept)) == 1
