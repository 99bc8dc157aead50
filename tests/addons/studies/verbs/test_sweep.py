"""`fleet sweep` as people type it: its table, its errors, and a study that goes on."""

from __future__ import annotations

import json
from functools import partial
from math import inf
from pathlib import Path

import msgspec
import pytest
from made_up_study import damage
from study_engine import Here, made_here
from tool import invoke

from fleet.addons.studies.row import Row
from fleet.addons.studies.store import Store
from fleet.addons.studies.verbs.documents import Swept

VARY = ["--vary", "network.links.*.loss=0 %,80 %", "--set", "network.links={'*': loss 1%}", "--seeds", "2"]
sweep = partial(invoke, "sweep")


@pytest.fixture(autouse=True)
def engines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Here]:
    """The engines that were used; runs are made in this process."""
    return made_here(tmp_path, monkeypatch)


def test_the_table_and_the_directory(engines: list[Here]) -> None:
    result = sweep("small.yaml", *VARY, "--measure", "loss_share")
    assert result.exit_code == 0, result.output
    (directory,) = Path("studies").iterdir()
    assert result.stdout.splitlines()[-1] == str(directory)
    assert f"{directory}: 2 points x 2 seeds = 4 runs" in result.stderr
    first, second = result.stdout.splitlines()[3:5]
    assert first.split()[:2] == ["0", "2"]
    assert second.split()[:2] == ["80", "2"]
    assert {"0..66", "34..100%"} & {"".join(line.split()[4:6]) for line in (first, second)}  # Wilson, of two runs


def test_a_study_that_is_whole_starts_no_worker(engines: list[Here]) -> None:
    quiet = sweep("small.yaml", *VARY, "-q")
    assert quiet.exit_code == 0
    assert quiet.stderr == ""
    directory = quiet.stdout.strip()
    again = sweep(directory)
    assert "4 runs, 4 of them made" in again.stderr
    assert len(engines) == 1
    damage(Path(directory), "DELETE FROM runs")
    assert Store.open(Path(directory)).missing == 4
    sweep(directory)
    assert len(engines[1].tasks) == 4
    assert Store.open(Path(directory)).missing == 0


def test_a_study_that_goes_on_has_no_budget_but_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    directory = sweep("small.yaml", *VARY, "-q", "--budget", "100 s").stdout.strip()
    damage(Path(directory), "DELETE FROM runs")
    budgets: list[float] = []

    def interrupted(*_: object, budget_s: float, **__: object) -> None:
        budgets.append(budget_s)
        raise KeyboardInterrupt

    monkeypatch.setattr("fleet.addons.studies.sweep.run_study", interrupted)
    sweep(directory)
    sweep(directory, "--budget", "5 s")
    assert budgets == [inf, 5.0]


def test_a_log_that_cannot_be_kept_is_told_and_the_table_shown(
    engines: list[Here], monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = sweep("small.yaml", *VARY, "-q").stdout.strip()
    monkeypatch.setattr(
        Here, "rows", lambda _, task: [Row(point=task.point, seed=task.seed, status="pass", digest="0")]
    )
    result = sweep(directory, "--keep-logs", "all")
    assert (result.exit_code, result.stderr.count("is not kept: it came out differently")) == (0, 4)
    assert "logs are missing" not in result.stderr
    assert result.stdout.splitlines()[-1] == directory


def test_a_study_of_a_border_is_refused_before_a_worker_starts(engines: list[Here]) -> None:
    directory = Path(sweep("small.yaml", *VARY, "-q").stdout.strip())
    record = json.loads((directory / "study.json").read_text("utf-8"))
    border = {"level": 0.5, "width": 0.1, "log": False}
    (directory / "study.json").write_text(json.dumps(record | {"border": border, "spec": None}), "utf-8")
    for options in ([], ["--show-config"]):
        result = sweep(str(directory), *options)
        assert result.exit_code == 2
        said = " ".join(result.stderr.split())
        assert "is a study of borders" in said
        assert f"To continue it: fleet boundary {directory}" in said
    assert len(engines) == 1


def test_checks_that_cannot_pass_are_told_as_fleet_check_does() -> None:
    late = ["--set", "checks={formation_error: {below: 1 m, after: 900 ms}}"]
    vary = ["--vary", "duration=500 ms, 1 s", "--seeds", "1"]
    said = "warning: checks.formation_error cannot pass: it begins after 0.9 s, and the run ends at 0.5 s"
    assert f"{said} (in 1 of 2 points, first duration=500 ms)" in " ".join(
        sweep("small.yaml", *late, *vary).stderr.split()
    )
    assert sweep("small.yaml", *late, *vary, "-q").stderr == ""
    checked = invoke("check", "small.yaml", *late, "--set", "duration=500 ms")
    assert said in " ".join(checked.stderr.split())


def test_a_study_that_is_there_shows_the_measures_that_are_asked_for_now() -> None:
    directory = sweep("small.yaml", *VARY, "-q").stdout.strip()
    shown = sweep(directory, "--measure", "e_rms_m").stdout
    assert "e_rms_m" in shown and "loss_share" not in shown


STUDY = """\
study:
  scenario: small.yaml
  vary: {loss: "0 %, 80 %"}
  net: "* loss {loss}"
  seeds: 2
  measures: loss_share
"""


def test_the_file_of_a_study_is_the_same_as_its_options(engines: list[Here]) -> None:
    Path("below").mkdir()
    Path("below/my-study.yaml").write_text(STUDY.replace("small.yaml", "../small.yaml"), "utf-8")
    options = ["--vary", "loss=0 %, 80 %", "--net", "* loss {loss}", "--seeds", "2", "--measure", "loss_share"]
    found = [
        Store.open(Path(sweep(*args, "-q").stdout.strip()))
        for args in (["below/my-study.yaml"], ["small.yaml", *options])
    ]
    assert found[0].directory.name.startswith("my-study-")
    assert found[0].points == found[1].points
    assert [row.digest for row in found[0].rows(details=True)] == [row.digest for row in found[1].rows(details=True)]


def test_a_study_is_shown_as_a_file_with_the_options_in_it_and_not_run(engines: list[Here]) -> None:
    Path("my-study.yaml").write_text(STUDY, "utf-8")
    options = ["--seeds", "3", "--set", "duration=2 s", "--vary", "loss=0 %,9 %", "--timeout", "90 s"]
    shown = sweep("my-study.yaml", *options, "--show-config")
    assert (shown.exit_code, shown.stderr) == (0, "")
    assert not Path("studies").exists()
    Path("shown.yaml").write_text(shown.stdout, "utf-8")
    again = sweep("shown.yaml", "--show-config")
    assert again.stdout == shown.stdout
    assert "timeout: 90 s" in shown.stdout
    made = sweep("shown.yaml", "-q", "--set", "duration=100 ms").stdout.strip()
    assert sweep(made, "--show-config").stdout == shown.stdout.replace("2 s", "100 ms")
    assert Store.open(Path(made)).record.seeds == [1, 2, 3]


def test_json_is_one_document_with_intervals(engines: list[Here]) -> None:
    result = sweep("small.yaml", *VARY, "--measure", "loss_share", "--json")
    document = msgspec.json.decode(result.stdout, type=Swept)
    assert Path(document.directory).is_dir()
    assert document.missing == 0
    assert document.units == {"network.links.*.loss": "%", "loss_share": ""}
    first, second = document.points
    assert (first.values, second.values) == ({"network.links.*.loss": 0.0}, {"network.links.*.loss": 80.0})
    assert first.medians["loss_share"].value == 0.0
    share = second.medians["loss_share"]
    assert 0.6 < share.value < 0.95
    assert (share.low, share.level, share.runs) == (None, None, 2)  # two runs are too few
    assert (second.passed.runs, second.passed.level) == (2, 0.95)
    assert sweep(document.directory, "--json", "--measure", "loss_share").stdout == result.stdout


def test_a_sweep_of_nothing(engines: list[Here]) -> None:
    """Runs that differ by their seeds are made, and it is told how to vary."""
    result = sweep("small.yaml", "--seeds", "2", "--set", "duration=100 ms")
    assert result.exit_code == 0, result.output
    assert "fleet: nothing is varied, so the runs differ only in their seeds; --vary" in result.stderr
    for quiet in (
        ["-q", "--set", "duration=100 ms"],
        ["--seeds", "1", "--set", "initial.scatter=0 m", "--show-config"],
    ):
        result = sweep("small.yaml", "--seeds", "1", *quiet)
        assert (result.exit_code, result.stderr) == (0, "")


def test_a_sweep_says_at_its_end_that_all_runs_are_the_same(engines: list[Here]) -> None:
    short = ["--seeds", "2", "--set", "duration=100 ms"]
    drawn = sweep("small.yaml", *short, "--set", "initial={scatter: 1 m}")
    same = sweep("small.yaml", *short, "--set", "initial={scatter: 0 m}", "--set", "network.links={}")
    assert "have the same log" not in drawn.stderr
    assert "all 2 runs have the same log" in same.stderr
