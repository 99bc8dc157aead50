"""The user's own checks in runs: as they stand, in studies, shrunk, and when a log is verified."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from fed_checks import fed
from small_scenario import SMALL, small
from study_engine import Here

from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.shrink import Shrinker
from fleet.addons.studies.sweep import check_names
from fleet.analysis.verdicts import standing
from fleet.checks.own_checks import OwnChecks
from fleet.execution.clock import GrantPolicy
from fleet.execution.execute import execute
from fleet.execution.in_process import InProcess
from fleet.execution.options import Options
from fleet.execution.whole_run import run_loaded
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import NoLog
from fleet.recorder.writer import LogWriter
from fleet.repeat.verify import verify
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.trust import Policy

PUSH = (
    "faults=[{id: mute, at: 200 ms, for: 300 ms, mute: 3},"
    "{id: push, at: 300 ms, for: 400 ms, wrench: {vehicles: 1, force: 400 0 0 N}}]"
)
FAST = "checks={signal: {name: fast, topic: state.u, below: 3 m/s}, tumbled: waived}"
MODULE = """\
from fleet.checks.api import Failure


class Slow:
    def __init__(self, facts, *, most=3.0): self.most = most

    def step(self, tick):
        fast = tuple(vehicle.id for vehicle in tick.vehicles if vehicle["state.u"] > self.most)
        return Failure("too fast", fast) if fast else None
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "slow_ones_here", raising=False)
    path = tmp_path / "slow_ones_here.py"
    path.write_text(MODULE)
    return path


def test_no_check_costs_nothing() -> None:
    assert OwnChecks.from_scenario(small("checks={ledger: balanced}")) is None


def test_checks_stand_as_they_do_while_a_run_goes_on() -> None:
    each = (
        "{name: low, topic: state.x, below: -9 m}",
        "{name: late, topic: state.x, below: 0 m, after: 900 ms}",
        "{name: soon, topic: state.x, above: 99 m, eventually_within: 900 ms}",
        "{name: fine, topic: state.z, below: 90 m}",
    )
    asked = f"checks={{signal: [{', '.join(each)}]}}"
    scenario = small(asked)
    journal = Journal(scenario, LogWriter(NoLog(), scenario), checks=OwnChecks.from_scenario(scenario))
    seen: list[dict[str, bool | None]] = []

    def look() -> None:
        if journal.written >= 0:
            seen.append({row["check"]: row["passed"] for row in standing(scenario, journal)})

    InProcess(scenario, journal).serve(GrantPolicy.of(scenario), look)
    names = ("low", "late", "soon", "fine")
    assert [seen[0][name] for name in names] == [False, None, None, True]


def test_a_named_check_can_be_shrunk() -> None:
    found = Shrinker(small(PUSH, FAST), Here(), lambda doing, runs: None).shrink("fast", most_runs=25)
    assert found.check == "fast" and [fault.id for fault in found.scenario.spec.faults] == ["push"]


def test_a_check_in_python_is_shrunk_swept_and_carried(module: Path) -> None:
    text = SMALL + 'checks:\n  "slow_ones_here:Slow": {most: 3}\n  tumbled: waived\n'
    scenario = parse_scenario(text, "small.yaml", [PUSH], module.parent, Policy(stranger=""))
    assert check_names([scenario])[:2] == ["tumbled", "Slow"]
    modules = modules_of([scenario], module.parent)
    assert modules.names == ("slow_ones_here",) and modules.files == (str(module),)
    found = Shrinker(scenario, Here(), lambda doing, runs: None, modules).shrink("Slow", most_runs=12)
    assert found.check == "Slow" and [fault.id for fault in found.scenario.spec.faults] == ["push"]


def test_a_log_is_verified_without_its_checks(module: Path) -> None:
    """They change no byte, so a log is verified where they are not, or may not run."""
    (module.parent / "here.yaml").write_text(SMALL + 'checks: {"slow_ones_here:Slow": {}}\n')
    result = execute(load_scenario("here.yaml"), Options(Path("runs"), in_process=True, quiet=True))
    assert result.directory is not None
    module.unlink()
    assert verify(result.directory).reproduced
    assert result.digest == run_loaded(small()).digest


def test_verdicts_come_in_the_order_of_the_scenario() -> None:
    checks = "signal: [{name: b, topic: nav.z, below: 9 m}, {name: a, topic: nav.z, below: 9 m}]"
    assert [verdict.check for verdict in fed(checks, lambda i, t: 5.0)] == ["b", "a"]
