"""Programs that fail are a failed check of studies like any other, and one that passes where none fails."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from pathlib import Path

import pytest
from failing_laws import module as module
from msgspec import structs
from talking import MOORED, talking
from tool import invoke

from fleet.addons.studies.bare_run import bare_verdicts, fits
from fleet.addons.studies.explanation.last_words import MOST_LINES
from fleet.addons.studies.explanation.why import Explanation, Question, lines
from fleet.addons.studies.one_run import Task, make_run
from fleet.addons.studies.row import CheckRow
from fleet.addons.studies.sweep import check_names
from fleet.errors import ScenarioError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.whole_run import run_loaded
from fleet.result.verdict import Margin
from fleet.scenario.loading import with_overrides
from fleet.scenario.scenario import Scenario

JUDGED = "checks.signal={topic: state.z, below: 99 m}"
FOUND = "vehicle 2: at 0.50 s: exit status 1: ValueError: planned"


def task(scenario: Scenario, *, bare: bool = False) -> Task:
    return Task("key", 0, 1, scenario.name, scenario.to_yaml(), inf, bare=bare)


def test_a_program_that_fails_fails_the_run(module: Callable[[str], str]) -> None:
    (verdict,) = [one for one in run_loaded(talking(module, fails_at=50)).checks if one.failed]
    assert (verdict.check, verdict.asked, verdict.found) == ("programs", "none fails", FOUND)
    assert verdict.margin == Margin(-1, "programs", verdict.moment.at_s if verdict.moment else None)
    assert verdict.moment is not None and (verdict.moment.tick, verdict.moment.vehicles) == (50, [2])


def test_the_check_is_there_only_when_one_has_failed(module: Callable[[str], str]) -> None:
    for changes, parameters in (((), {}), (("checks.programs=waived",), {"fails_at": 50})):
        verdicts = run_loaded(talking(module, *changes, **parameters)).checks
        assert "programs" not in {one.check for one in verdicts}
        assert all(one.passed for one in verdicts)
    with pytest.raises(ScenarioError, match="has no effect without nodes"):
        talking(module, "checks.programs=running")


@pytest.mark.parametrize("bare", [False, True])
def test_rows_of_studies_have_it(bare: bool, module: Callable[[str], str]) -> None:
    """A row has it in any case: a share of runs that pass is one of all runs."""
    rows = {}
    for fails_at in (-1, 50):
        scenario = talking(module, JUDGED, text=MOORED, fails_at=fails_at)
        assert fits(scenario)
        assert "programs" in check_names([scenario])
        rows[fails_at] = make_run(task(scenario, bare=bare))
    assert rows[-1].checks["programs"] == CheckRow(True, 0.0, 0.0)
    assert rows[50].checks["programs"] == CheckRow(False, 1.0, -1.0)
    assert rows[50].failed_checks == ["programs"]


def test_a_bare_run_leaves_a_failure_to_the_emulator(module: Callable[[str], str]) -> None:
    scenario = talking(module, JUDGED, text=MOORED, fails_at=50)
    assert bare_verdicts(scenario) == []
    assert [one.check for one in bare_verdicts(with_overrides(scenario, ["checks.programs=waived"]))] == ["state.z"]


def test_a_search_finds_it(module: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("talk.yaml").write_text(talking(module, JUDGED, text=MOORED, fails_at=50).to_yaml(), "utf-8")
    for check in ([], ["--check", "programs"]):
        done = invoke("search", "talk.yaml", "--nemesis", *check, "--budget", "2", "--force")
        assert "programs" in done.stdout, done.stderr


def test_why_shows_what_was_said_last(module: Callable[[str], str], tmp_path: Path) -> None:
    result = execute(talking(module, fails_at=50), Options(tmp_path, in_process=True, quiet=True))
    assert result.directory is not None
    why = Explanation(Question(result.directory, None, 0), lambda doing, runs: None).without_runs()
    assert why.check == "programs"
    assert len(why.said) == MOST_LINES
    assert [(one.at_s, one.vehicle) for one in why.said] == sorted((one.at_s, one.vehicle) for one in why.said)
    assert "what the programs had said last by 0.5 s" in lines(why)
    shown = lines(why)[lines(why).index("what the programs had said last by 0.5 s") + 1 :][:MOST_LINES]
    assert shown[-2:] == [
        "  0.500 s  vehicle 2 (err): ValueError: planned",
        "  0.500 s  vehicle 2 (failed): exit status 1",
    ]
    named = "\n".join(lines(structs.replace(why, nodes=["auv1", "ship", "auv3", "auv4"])))
    assert "  0.500 s  ship (err): ValueError: planned" in named
    assert "\x1b" not in "".join(shown)


def test_why_shows_it_for_any_check(module: Callable[[str], str], tmp_path: Path) -> None:
    deep = "checks.signal={topic: state.z, below: 0.1 m, after: 300 ms}"
    result = execute(talking(module, deep), Options(tmp_path, in_process=True, quiet=True))
    assert result.directory is not None
    why = Explanation(Question(result.directory, None, 0), lambda doing, runs: None).without_runs()
    assert why.check == "state.z"
    assert why.said[-1].at_s <= 0.3
    assert why.said[-1].text == "caf? \x1b[31m"
    assert all("error.formation_norm" in then.signals for then in why.vehicles)


def test_of_moored_vehicles_no_error_is_told_as_they_have_no_place_to_keep(
    module: Callable[[str], str], tmp_path: Path
) -> None:
    scenario = talking(module, "checks.signal={topic: state.z, below: -1 m}", text=MOORED)
    result = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert result.directory is not None
    why = Explanation(Question(result.directory, None, 0), lambda doing, runs: None).without_runs()
    assert why.vehicles and not any("error.formation_norm" in then.signals for then in why.vehicles)
