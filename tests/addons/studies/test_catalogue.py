"""The studies that ship: what the list says of them is true, and they can be run."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fleet.addons.studies.catalogue import list_studies, shipped_studies
from fleet.addons.studies.plan import Plan, plan_of
from fleet.addons.studies.study_file import study_named
from fleet.addons.studies.sweep import load_points
from fleet.quantities import time_ns
from fleet.scenario.catalogue import shipped_scenarios


def thinned(plan: Plan) -> Plan:
    """A plan whose points have every value of every axis at least once."""
    longest = max(len(axis.values) for axis in plan.axes)
    axes = [replace(axis, values=(axis.values * longest)[:longest]) for axis in plan.axes]
    return replace(plan, axes=tuple(axes), zipped=True)


def test_no_name_is_of_a_scenario_and_of_a_study() -> None:
    assert not {*shipped_scenarios()} & {*shipped_studies()}


def test_the_list_says_what_a_study_is() -> None:
    listed = list_studies()
    assert [study.name for study in listed] == ["acoustic", "controllers", "loss-delay", "rate"]
    for study in listed:
        named = study_named(study.name)
        assert (study.title, study.scenario, study.runs) == (
            named.spec.title,
            named.spec.scenario,
            len(plan_of(named.spec)),
        )
        assert study.title.endswith("?")
        assert study.core_s == pytest.approx(study.runs * time_ns(named.spec.run_takes) / 1e9)


@pytest.mark.parametrize("name", shipped_studies())
def test_what_ships_can_be_run(name: str) -> None:
    named = study_named(name)
    scenarios = load_points(thinned(plan_of(*named)))
    assert len({scenario.to_yaml() for scenario in scenarios}) == len(scenarios)
