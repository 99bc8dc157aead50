"""The list of shipped scenarios is read without the schema, and says what the loaded scenarios say."""

from __future__ import annotations

import pytest
from msgspec.structs import astuple, replace

from fleet.scenario import catalogue
from fleet.scenario.catalogue import ListedScenario, list_scenarios, shipped_scenarios
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.schema.groups import GROUPS


def test_the_list_agrees_with_the_loaded_scenarios() -> None:
    loaded = [load_scenario(name) for name in shipped_scenarios()]
    assert [replace(row, group="") for row in list_scenarios()] == [
        ListedScenario(s.name, "", s.title, s.vehicles, s.duration_ns / 1e9, s.spec.expect) for s in loaded
    ]
    assert {row.expect for row in list_scenarios()} == {"pass", "fail"}


def test_what_a_file_leaves_out_or_writes_in_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """No `name`, a title in quotes, another unit, an anchor and comments; `expect` in both ways."""
    text = """
title: "Two: a # in quotes"  # a comment
vehicles: &n 2
duration: 1.5 min
reference: {start: 0 0 5 m, velocity: 1 0 0 m/s}
formation: {shape: line}
graph: {shape: path}
initial: {scatter: 1 m}
network: {period: 100 ms}
checks: {tumbled: waived}
"""
    monkeypatch.setattr(catalogue, "shipped_scenarios", lambda: ["two"])
    for more, expect in (("", "pass"), ("expect: fail\n", "fail")):
        monkeypatch.setattr(catalogue, "shipped_text", lambda name, more=more: text + more)
        scenario = parse_scenario(text + more, "two.yaml")
        assert scenario.spec.expect == expect
        assert list_scenarios() == [ListedScenario("two", "", "Two: a # in quotes", 2, 90.0, expect)]
        assert (scenario.name, scenario.spec.group, scenario.title, scenario.vehicles) == (
            "two", None, *astuple(list_scenarios()[0])[2:4],
        )  # fmt: skip
        assert scenario.duration_ns == 90 * 10**9


def test_every_scenario_that_ships_has_a_group() -> None:
    """And no group is empty: `fleet list` shows what has one."""
    rows = list_scenarios()
    assert {row.group for row in rows} == set(GROUPS), [row.name for row in rows if not row.group]


def test_the_group_is_no_part_of_a_run() -> None:
    """The scenario that a log holds is the same, whatever group it stands in."""
    scenario = load_scenario("lossy")
    assert scenario == load_scenario("lossy", ["group=faults"])
    assert "group" not in scenario.to_yaml()
