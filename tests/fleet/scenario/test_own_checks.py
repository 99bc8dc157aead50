"""The user's own checks in a scenario: what is read, written back and refused, each mistake at its place."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from small_scenario import SMALL, WILD, accepted, read_back, small

from fleet.scenario.loading import parse_scenario
from fleet.scenario.schema.checks import SignalCheck


def test_a_vehicle_that_is_named_has_the_signal() -> None:
    checks = "checks={{signal: {{topic: state.phi, below: 1 rad{}}}}}"
    plant = "per_vehicle={2: {vehicle: {plant: remus100}}}"
    assert small(checks.format(""), plant).spec.checks.signal
    assert small(checks.format(", vehicles: 2"), plant).spec.checks.signal


def test_names_are_unique() -> None:
    scenario = small("checks={signal: [{topic: state.z, below: 9 m}, {topic: state.z, above: 0 m}, "
                     "{topic: '|error.e|', below: 9 m}, {name: state.z-2, topic: state.x, below: 9 m}]}")  # fmt: skip
    assert [check.name for check in scenario.spec.checks.own()] == ["state.z", "state.z-3", "error.e", "state.z-2"]


def test_a_scenario_is_written_back() -> None:
    scenario = small(
        "checks={signal: [{name: a, topic: '|error.e|', equals: 3 m, within: 10 cm, vehicles: all, after: 300 ms}, "
        "{topic: state.z, within: [1 m, 2 m], never: true, for_at_least: 1 s}, {topic: state.u, at_most_one: true}]}"
    )
    read_back(scenario)
    assert "never: true" in scenario.to_yaml()
    assert "signal" not in small().to_yaml()
    classes = '"no_module_here:A": [{x: 2 s, name: one}, {}]'
    with_class = parse_scenario(f"{SMALL}checks: {{{classes}, ledger: balanced}}\n", "s")
    assert "no_module_here:A" in with_class.to_yaml()
    assert parse_scenario(with_class.to_yaml(), "s") == with_class
    assert [check.name for check in with_class.spec.checks.own()] == ["one", "A"]


@given(key=st.sampled_from([*SignalCheck.model_fields, "signal"]), value=WILD)
def test_anything_is_read_or_refused(key: str, value: str) -> None:
    check = value if key == "signal" else f"{{topic: state.z, below: 3 m, {key}: {value}}}"
    accepted(f"checks.signal={check}")
