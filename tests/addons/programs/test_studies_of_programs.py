"""What explains, repeats and continues runs of laws does so for programs: why, verify, regress, rare, pytest."""

from __future__ import annotations

import json
import sys
from math import inf
from pathlib import Path
from textwrap import dedent

import loaded_once  # noqa: F401
import pytest
from own_program import scenario
from repository import ROOT
from study_engine import made_here
from tool import invoke

import fleet
from fleet.addons.studies.branches import Branches, run_branches
from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import PartRow, Row
from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import load_scenario

pytest_plugins = ["pytester"]
SONAR = ROOT / "docs/examples/sonar_lease"
STALE = ("self.voted == (other, number)", "self.voted[0] == other")  # a vote is freed by an older number
SHORT = ("nemesis=null", "seed=2", "duration=2300 ms")
BRIEF = ("nemesis=null", "duration=2 s")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies make their runs in this process; `sonar.yaml` and `sonar.py` with a defect are in the current folder."""
    made_here(tmp_path, monkeypatch, (SONAR / "sonar.yaml").read_text("utf-8"))
    (tmp_path / "small.yaml").rename(tmp_path / "sonar.yaml")
    plant(tmp_path)


def plant(folder: Path, planted: bool = True) -> None:
    text = (SONAR / "sonar.py").read_text("utf-8")
    assert STALE[0] in text
    (folder / "sonar.py").write_text(text.replace(*STALE) if planted else text, "utf-8")


def test_why_says_who_had_the_water_and_verify_repeats_the_run() -> None:
    result = fleet.run("sonar.yaml", set=SHORT, out="runs")
    assert [verdict.check for verdict in result.checks if verdict.failed] == ["one-at-a-time"]
    assert "reproduced bit for bit" in invoke("verify", "runs/latest").output
    why = json.loads(invoke("why", "runs/latest", "--json").stdout)
    assert why["check"] == "one-at-a-time" and why["at_s"] == 2.16
    using = {then["vehicle"]: then["signals"]["control.sonar"] for then in why["vehicles"]}
    assert using == {1: 1.0, 2: 0.0, 3: 1.0}
    assert why["no_return"]["passes_s"] is None  # no fault is to be healed


def test_a_failure_of_a_program_is_kept_and_its_repair_shows(tmp_path: Path) -> None:
    asked = ("--set", "seed=4", "--set", "duration=4 s", "--set", "nemesis.unit=200 ms")
    found = invoke("search", "sonar.yaml", "--budget", 1, "--keep", "failures", *asked)
    assert found.exit_code == 1 and "one-at-a-time: first with seed 4" in found.stdout, found.output
    again = invoke("regress", "failures")
    assert again.exit_code == 0 and "1 of 1 are as expected" in again.stdout, again.output
    plant(tmp_path, planted=False)
    mended = invoke("regress", "failures")
    assert mended.exit_code == 1 and "passes; expected: fails one-at-a-time" in mended.stdout, mended.output
    assert invoke("regress", "failures", "--accept").exit_code == 0
    assert invoke("regress", "failures").exit_code == 0


def test_a_run_of_programs_can_go_on_from_a_moment_in_many_ways() -> None:
    """As `fleet rare` asks: in copies of a worker, and one after the other here."""
    changes = (*BRIEF, "checks={max_age: {below: 9 s}}", "log={every: 1 tick}", "network.links.*.loss=40%")
    scenario = load_scenario("sonar.yaml", changes)

    def part(salt: int, way: tuple[tuple[int, int], ...] = (), best: float = inf) -> PartRow:
        (row,) = run_branches(scenario, Branches("max_age", way, (salt,), best), lambda t: None)
        assert row.part is not None
        return row.part

    whole = next(verdict for verdict in run_loaded(scenario).checks if verdict.check == "max_age")
    first = part(0)
    assert whole.margin is not None and first.best == whole.margin.value
    margin, tick = first.places[1]
    assert part(0, ((0, tick),), margin).best == first.best
    asked = Branches("max_age", ((0, tick),), (1, 2, 3, 0), margin)
    rows: list[Row] = []
    with local_engine(1) as engine:
        modules = modules_of([scenario], Path())
        task = Task("parts", 0, scenario.seed, "sonar", scenario.to_yaml(), inf, modules, branches=asked)
        engine.make(iter([task]), rows.extend, lambda: None)
    here = [one.part.best for one in run_branches(scenario, asked, lambda t: None) if one.part is not None]
    assert [one.part.best for one in rows[0].futures if one.part is not None] == here
    assert len({*here}) > 1 and here[-1] == first.best


def test_rare_estimates_how_often_a_message_is_old() -> None:
    changes = [part for each in (*BRIEF, "checks={max_age: {below: 900 ms}}") for part in ("--set", each)]
    done = invoke("rare", "sonar.yaml", "--check", "max_age", "--repeats", 2, "--effort", 6, *changes)
    assert done.exit_code == 0 and "sonar fails max_age with probability" in done.stdout, done.output


def test_the_pytest_plugin_runs_programs(pytester: pytest.Pytester) -> None:
    pytester.makefile(".yaml", sonar=(SONAR / "sonar.yaml").read_text("utf-8"))
    asked = "'sonar.yaml', seeds=2, set={'nemesis': 'null', 'duration': '2300 ms'}"
    pytester.makepyfile(f"def test_it(fleet_runs):\n    fleet_runs({asked})\n")
    plugins = ("-p", "no:uuv-fleet", "-p", "fleet.addons.studies.pytest_plugin", "-p", "no:cacheprovider")
    for planted, counts in ((True, {"failed": 1}), (False, {"passed": 1})):
        plant(pytester.path, planted)
        result = pytester.runpytest_inprocess(*plugins)
        result.assert_outcomes(**counts)
        if planted:
            result.stdout.fnmatch_lines(["*sonar.yaml fails one-at-a-time with seed 2, of 2 seeds"])
    assert "sonar" not in sys.modules


IMPATIENT = """
    import socket, sys
    me = int(sys.argv[1])
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("", 9000))
    s.settimeout(0.05)
    silent = 0
    while silent < 12:
        s.sendto(b"x", (f"auv{3 - me}", 9000))
        try: silent, _ = 0, s.recv(9)
        except TimeoutError: silent += 1
    raise SystemExit("nobody is there")
"""


def test_a_crash_is_searched_made_smaller_kept_and_counted(
    pytester: pytest.Pytester, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check `programs` is one like all others: search, shrink, boundary, why, fleet_runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "program.py").write_text(dedent(IMPATIENT))
    (tmp_path / "own.yaml").write_text(scenario() + "nemesis: {mode: episodes, unit: 500 ms, pick: [partition]}\n")
    cuts = ("--set", "duration=8 s", "--set", "seed=1")
    found = invoke("search", "own.yaml", "--check", "programs", "--budget", 4, *cuts)
    assert found.exit_code == 1 and "Then programs fails" in found.stdout, found.output
    assert "partition" in (tmp_path / "own-least.yaml").read_text()
    fault = "faults=[{at: 1 s, for: 3 s, partition: 1 / 2}, {at: 5 s, for: 100 ms, mute: 1}]"
    changes = ("--set", "nemesis=null", "--set", "duration=6 s", "--set", fault)
    assert invoke("run", "own.yaml", "--in-process", "-q", *changes).exit_code == 1
    why = json.loads(invoke("why", "runs/latest", "--json").stdout)
    assert why["check"] == "programs" and why["at_s"] == pytest.approx(1.62, abs=0.1)
    shrunk = invoke("shrink", "runs/latest", "--out", "small.yaml", "--quiet")
    assert shrunk.exit_code == 0 and "mute" not in (tmp_path / "small.yaml").read_text(), shrunk.output
    border = invoke("boundary", "own.yaml", "--along", "network.links.*.loss=0 %..90 %", "--width", 0.5, *changes[:4])
    assert border.exit_code == 0 and "50 %" in border.stdout, border.output
    monkeypatch.chdir(pytester.path)
    pytester.makefile(".yaml", own=(tmp_path / "own.yaml").read_text())
    pytester.makepyfile(program=dedent(IMPATIENT))
    asked = f"'own.yaml', seeds=1, set={['nemesis=null', 'duration=3 s', fault]!r}"
    pytester.makepyfile(test_it=f"def test_it(fleet_runs):\n    fleet_runs({asked})\n")
    plugins = ("-p", "no:uuv-fleet", "-p", "fleet.addons.studies.pytest_plugin", "-p", "no:cacheprovider")
    result = pytester.runpytest_inprocess(*plugins, "test_it.py")
    result.stdout.fnmatch_lines(["*own.yaml fails programs with seed 1*"])
