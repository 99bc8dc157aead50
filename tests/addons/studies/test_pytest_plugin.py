"""The pytest plugin: what fails a test, what it prints, what it keeps, and what it costs who does not use it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from small_scenario import SMALL

pytest_plugins = ["pytester"]
TEST = """
def test_it(fleet_runs):
    results = fleet_runs("small.yaml", seeds={seeds}, set={{"checks": {checks!r}}})
    assert [result.seed for result in results] == list(range(1, {seeds} + 1))
"""
PASSES = "{formation_error: {below: 99 m}, tumbled: waived}"
FAILS = "{formation_error: {below: 1 m}, tumbled: waived}"
NEVER = "{tumbled: waived, signal: {name: deep, topic: state.z, above: 99 m, sometimes: true}}"


def run(pytester: pytest.Pytester, checks: str, *args: str) -> pytest.RunResult:
    pytester.makefile(".yaml", small=SMALL)
    pytester.makepyfile(TEST.format(seeds=2, checks=checks))
    # By its module, whether or not it is installed: pytest would have it twice otherwise.
    plugins = ("-p", "no:uuv-fleet", "-p", "fleet.addons.studies.pytest_plugin", "-p", "no:cacheprovider")
    return pytester.runpytest_inprocess(*plugins, *args)


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
