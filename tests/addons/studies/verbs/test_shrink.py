"""`fleet shrink` as people type it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from small_scenario import SMALL, small
from study_engine import made_here
from tool import invoke

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.verbs.documents import ShrunkScenario
from fleet.addons.studies.verbs.search import write_least
from fleet.execution.whole_run import run

FAILING = """\
faults:
  - {at: 100 ms, for: 300 ms, mute: 3}
  - {at: 300 ms, for: 400 ms, wrench: {vehicles: 1, force: 400 0 0 N}}
checks: {formation_error: {below: 4.6 m, after: 800 ms}}
"""


@pytest.fixture(autouse=True)
def failing_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_here(tmp_path, monkeypatch, SMALL + FAILING)


def test_the_least_scenario_is_written_and_fails(tmp_path: Path) -> None:
    result = invoke("shrink", "small.yaml")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].startswith("One fault is enough: wrench ")
    assert ". Then formation_error fails. See why: fleet run small-least.yaml; fleet why" in lines[0]
    assert lines[1] == "  1 of 2 faults are needed"
    assert lines[-1] == "small-least.yaml"
    assert not run("small-least.yaml").passed
    again = invoke("shrink", "small.yaml")
    assert again.exit_code == 2
    assert "small-least.yaml is there already" in again.stderr
    assert invoke("shrink", "small-least.yaml", "--out", "small-least.yaml", "--force").exit_code == 0


def test_a_scenario_that_cannot_be_written_after_all_is_printed(tmp_path: Path) -> None:
    tried = small()
    with pytest.raises(StudyError, match="the least scenario stands above"):
        write_least(tried, tmp_path)  # a folder


def test_json_says_what_was_removed() -> None:
    result = invoke("shrink", "small.yaml", "--json")
    found = msgspec.json.decode(result.stdout, type=ShrunkScenario)
    assert (found.file, found.scenario, found.check) == ("small-least.yaml", "small", "formation_error")
    assert found.steps[0] == "1 of 2 faults are needed"
    assert (found.before.faults, found.after.faults) == (2, 1)
    assert (found.before.vehicles, found.before.duration_s) == (3, 1.0)
    assert found.after.duration_s <= 1.0
    assert found.runs > 5
    assert Path(found.file).exists()


def test_a_log_is_shrunk_as_it_happened() -> None:
    made = invoke("run", "small.yaml", "--in-process", "-q")
    assert made.exit_code == 1
    result = invoke("shrink", made.stdout.strip(), "-o", "least.yaml")
    assert result.exit_code == 0, result.output
    assert "1 of 2 faults are needed" in result.stdout


def test_ctrl_c_leaves_no_file_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fleet.addons.studies.shrink.Shrinker.shrink", interrupt)
    assert "so small-least.yaml is not written; --budget N" in invoke("shrink", "small.yaml").stderr
    assert not Path("small-least.yaml").exists()
