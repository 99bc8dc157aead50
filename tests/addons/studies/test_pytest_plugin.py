"""The pytest plugin: what fails a test, what it prints, what it keeps, and what it costs who does not use it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import loaded_once  # noqa: F401
import pytest
import yaml
from repository import ROOT
from small_scenario import SMALL

pytest_plugins = ["pytester"]
TEST = """
def test_it(fleet_runs):
    results = fleet_runs("small.yaml", seeds={seeds}, set={{"checks": {checks!r}}})
    assert [result.seed for result in results] == list(range(1, {seeds} + 1))
"""
# By its module, whether or not it is installed: pytest would have it twice otherwise.
PLUGINS = ("-p", "no:uuv-fleet", "-p", "fleet.addons.studies.pytest_plugin", "-p", "no:cacheprovider")
PASSES = "{formation_error: {below: 99 m}, tumbled: waived}"
FAILS = "{formation_error: {below: 1 m}, tumbled: waived}"
NEVER = "{tumbled: waived, signal: {name: deep, topic: state.z, above: 99 m, sometimes: true}}"


def run(pytester: pytest.Pytester, checks: str, *args: str) -> pytest.RunResult:
    pytester.makefile(".yaml", small=SMALL)
    pytester.makepyfile(TEST.format(seeds=2, checks=checks))
    return pytester.runpytest_inprocess(*PLUGINS, *args)


def test_all_seeds_pass(pytester: pytest.Pytester) -> None:
    run(pytester, PASSES).assert_outcomes(passed=1)
    assert not (pytester.path / "fleet-failures").exists()


def test_a_failure_says_the_line_to_paste_and_keeps_the_log(pytester: pytest.Pytester) -> None:
    result = run(pytester, FAILS, "--fleet-keep", "kept")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["*small.yaml fails formation_error with seed 1, of 2 seeds", "*formation_error: below*"]
    )
    result.stdout.fnmatch_lines(
        [f"fleet run small.yaml --seed 1 --set 'checks={FAILS}'  # sha256 *".replace("[", "[[]")]
    )
    kept = pytester.path / "kept" / "test_it-seed-1"
    assert sorted(path.name for path in kept.iterdir()) == ["result.json", "run.mcap", "scenario.yaml"]


def test_links_and_faults_are_changed_as_by_options(pytester: pytest.Pytester) -> None:
    pytester.makefile(".yaml", small=SMALL)
    pytester.makepyfile(
        """
        def test_it(fleet_runs):
            fleet_runs("small.yaml", 2, net=["1->2 loss 100%"], fault=["at 100 ms for 200 ms mute 3"],
                       set={"checks": "{max_age: {below: 300 ms}, tumbled: waived}"})
        """
    )
    result = pytester.runpytest_inprocess(*PLUGINS)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["fleet run small.yaml --seed 1 --set * --net '1->2 loss 100%' --fault 'at 100 ms for 200 ms mute 3'  # *"]
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [("'smal.yaml'", "smal.yaml: No such file or directory"), ("'small.yaml', net=['1->9 loss 3%']", "*1->9*"),
     ("'small.yaml', set={'durration': '3 s'}", "*did you mean \"duration\"?*")],
)  # fmt: skip
def test_a_mistake_fails_in_words_and_without_our_internals(call: str, words: str, pytester: pytest.Pytester) -> None:
    pytester.makefile(".yaml", small=SMALL)
    pytester.makepyfile(f"def test_it(fleet_runs):\n    fleet_runs({call})\n")
    result = pytester.runpytest_inprocess(*PLUGINS, "--disable-warnings")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([words])
    assert len(result.outlines) < 25 and "stepped_run" not in result.stdout.str()


def test_what_no_run_reached_fails(pytester: pytest.Pytester) -> None:
    result = run(pytester, NEVER)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*no run fails, and that says little: deep was reached in none of 2 runs"])


def test_it_imports_almost_nothing() -> None:
    """pytest loads it wherever the package is installed."""
    plugin = "fleet.addons.studies.pytest_plugin"
    code = f"import pytest, sys; n = len(sys.modules); import {plugin}; print(len(sys.modules) - n)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 5  # the packages that it is in, too


def test_the_action_of_github_takes_words_apart_as_a_shell_and_runs_none_of_them(tmp_path: Path) -> None:
    """A value with blanks is one word, and what looks like a command stays text."""
    action = yaml.safe_load((ROOT / ".github/actions/fleet/action.yml").read_text("utf-8"))
    script = next(step["run"] for step in action["runs"]["steps"] if "fleet sweep" in step.get("run", ""))
    said = tmp_path / "said"
    (tmp_path / "fleet").write_text(f"#!/bin/sh\nprintf '%s\\n' \"$@\" > {said}\n")
    (tmp_path / "fleet").chmod(0o755)
    words = "mission.yaml --vary 'network.links.*.loss=0 %..40 %/10 %' --set '$(touch broken)' `x`"
    found = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "OUT": str(tmp_path / "out"), "SWEEP": words}
    subprocess.run(["bash", "-e", "-c", script], env=os.environ | found, cwd=tmp_path, check=True)
    assert said.read_text().splitlines() == [
        "sweep", "mission.yaml", "--vary", "network.links.*.loss=0 %..40 %/10 %", "--set", "$(touch broken)", "`x`",
        "--out", f"{tmp_path}/out", "--junit", f"{tmp_path}/out/sweep.xml",
    ]  # fmt: skip
    assert not (tmp_path / "broken").exists()
