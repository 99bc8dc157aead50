"""Studies by name: what ships is sound, and a file of a stranger's runs no code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from agents.plugins.trust import Trust
from fleet.errors import ScenarioError
from fleet.scenario.catalogue import shipped_scenarios
from fleet.study.catalogue import list_studies, shipped_studies, study_named
from fleet.study.errors import StudyError
from fleet.study.plan import Plan
from fleet.study.sweep import load_points


def thinned(plan: Plan) -> Plan:
    """A plan whose points have every value of every axis at least once."""
    longest = max(len(axis.values) for axis in plan.axes)
    axes = [replace(axis, values=(axis.values * longest)[:longest]) for axis in plan.axes]
    return replace(plan, axes=tuple(axes), zipped=True)


def test_no_name_is_of_a_scenario_and_of_a_study() -> None:
    assert not {*shipped_scenarios()} & {*shipped_studies()}


def test_the_list_says_what_a_study_is() -> None:
    found = {study.name: study for study in list_studies()}
    assert list(found) == ["acoustic", "controllers", "loss-delay", "rate"]
    assert found["loss-delay"].runs == 2 * 7 * 7 * 20
    assert all(study.title.endswith("?") and study.core_s >= study.runs / 2 for study in found.values())
    assert all(study.scenario in shipped_scenarios() for study in found.values())


@pytest.mark.parametrize("name", shipped_studies())
def test_what_ships_can_be_run(name: str) -> None:
    named = study_named(name)
    assert named is not None
    scenarios = load_points(thinned(named.spec.plan(named.origin)))
    assert len({scenario.to_yaml() for scenario in scenarios}) == len(scenarios)


def test_what_is_no_study_is_left_to_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scenario.yaml").write_text("vehicles: 3\n", "utf-8")
    Path("log.mcap").write_bytes(b"\x89MCAP0\r\n\xff\xfe")
    for name in ("paper", "nosuch", "nosuch.yaml", "scenario.yaml", "log.mcap", ".", "/dev/null", "a\0b", ""):
        assert study_named(name) is None, name
    with pytest.raises(StudyError, match='no study or scenario los-delay; did you mean "loss-delay"'):
        study_named("los-delay")


@pytest.mark.parametrize(
    ("file", "runs"),
    [("here.yaml", True), ("below/it.yaml", False), ("../stranger/it.yaml", False)],
)
def test_laws_of_a_study_obey_the_rules_of_scenarios(
    file: str, runs: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    for folder in (here, here / "below", tmp_path / "stranger"):
        folder.mkdir()
    monkeypatch.chdir(here)
    module = f"law_for_{'here' if runs else Path(file).parent.name}"
    Path(f"{module}.py").write_text("from pathlib import Path\nPath('it_ran').touch()\n", "utf-8")
    text = f"study: {{scenario: paper, set: {{controller: {{law: '{module}:Law'}}}}}}"
    Path(file).write_text(text, "utf-8")
    named = study_named(file)
    assert named is not None
    with pytest.raises(ScenarioError) as caught:
        load_points(named.spec.plan(named.origin))
    assert Path("it_ran").exists() is runs
    assert ("has no 'Law'" if runs else f"would run {module}.py, which is not installed") in str(caught.value)
    if not runs:
        with pytest.raises(ScenarioError, match="has no 'Law'"):
            load_points(named.spec.plan(named.origin), Trust(everything=True))
        assert Path("it_ran").exists()
