"""A log judged by checks: the verdicts of the run itself, also of one that was cut, thinned, or goes on."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from in_process_runs import recorded
from refusals import check_refusals
from small_scenario import SMALL
from tool import invoke

from fleet.errors import FleetError, ScenarioError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.repeat.check_log import check_log
from fleet.repeat.resume import continuation
from fleet.result.result import Result
from fleet.result.verdict import Verdict
from fleet.scenario.sections.signal_checks import SignalCheckError

MODULE = """\
from fleet.checks.api import Failure


class Packets:
    \"\"\"Counts what it is shown\"\"\"

    def __init__(self, facts):
        self.begin, self.counts = facts.begin, [0, 0, 0]

    def step(self, tick):
        self.counts[0] += 1
        self.counts[1] += len(tick.packets)
        self.counts[2] += len(tick.faults)
        if tick.vehicles[0]["control.u_err"] is None and tick.t < 2:
            return Failure("no control", (1,))

    def verdict(self):
        return f"{self.begin:g} s: {self.counts}"
"""
AGENT = """\
from agents.api import FormationAgent, Signal


class Mine(FormationAgent):
    signals = (Signal("mine", "1", "always 3"),)

    def __init__(self, config):
        super().__init__(config)
        self.signals = type(self).signals

    def decide(self, nav, deliveries):
        return super().decide(nav, deliveries)[0], {"mine": 3.0}
"""
CHECKS = """\
duration: 2 s
faults: [{id: cut, at: 500 ms, for: 500 ms, down: 1->2}]
checks:
  signal:
    - {name: low, topic: state.z, below: 1 m}
    - {name: speed, topic: control.u_err, within: [-9 m/s, 9 m/s], after: 1 s}
    - {name: norm, topic: "|error.e|", never: true, above: 10 mm, for_at_least: 300 ms}
    - {name: again, topic: error.e_norm, below: 1 mm, eventually_within: 200 ms, fault: every}
    - {name: spread, topic: command.tau_0, spread_below: 1000 N}
  "packets_seen_here:Packets": {}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))  # installed, so to speak
    monkeypatch.delitem(sys.modules, "packets_seen_here", raising=False)
    (tmp_path / "packets_seen_here.py").write_text(MODULE)
    (tmp_path / "here.yaml").write_text(SMALL.replace("duration: 1 s\n", "") + CHECKS)
    return tmp_path


def run(*overrides: str) -> Result:
    result = recorded(Path("runs"), "here.yaml", *overrides)
    assert result.directory is not None
    return result


def own(result: Result) -> list[Verdict]:
    names = ("low", "speed", "norm", "again", "spread", "Packets")
    return [verdict for verdict in result.checks if verdict.check in names]


LOSSY = "network.links={1->2: loss 50 %}"


@pytest.mark.parametrize("change", ["seed=1", "log.every=4 ticks", "log.state=3 ticks", LOSSY])
def test_a_log_gives_the_verdicts_of_its_run(folder: Path, change: str) -> None:
    result = run(change)
    assert result.directory is not None
    again = check_log(result.directory)
    assert again.verdicts == own(result)
    assert {verdict.check: verdict.passed for verdict in again.verdicts} == {
        "low": False, "speed": True, "norm": False, "again": False, "spread": True, "Packets": True,
    }  # fmt: skip
    norm, late = again.verdicts[2].moment, again.verdicts[3].moment
    assert norm is not None and norm.message is not None and late is not None and late.at_s > 1.2
    assert (again.until_s, again.end_s, again.missing, again.passed) == (2.0, 2.0, "", False)
    row = next(check for check in result.values["checks"] if check["check"] == "norm")
    assert row["moment"]["message"]["dst"] in row["moment"]["vehicles"]


SILENT = """checks={deaths: waived, signal: [
{name: late, topic: guidance.neighbours_heard, above: 9, eventually_within: 1 s},
{name: none, topic: guidance.neighbours_heard, above: 0, after: 600 ms},
{name: soon, topic: guidance.neighbours_heard, above: 9, eventually_within: 1900 ms}]}"""


def test_silence_in_a_log_is_judged_as_in_its_run(folder: Path) -> None:
    result = run("faults=[{id: gone, at: 500 ms, kill: 1-3}]", SILENT)
    assert result.directory is not None
    again = check_log(result.directory)
    assert again.verdicts == [verdict for verdict in result.checks if verdict.check in ("late", "none", "soon")]
    assert [verdict.found.partition(";")[0] for verdict in again.verdicts] == [
        "not within 1 s after 0 s (vehicles 1, 2, 3)", "no sample", "not within 1.9 s after 0 s (vehicles 1, 2, 3)",
    ]  # fmt: skip
    assert again.until_s == 2.0


def test_a_cut_log_is_judged_to_where_it_is_whole(folder: Path) -> None:
    result = run("duration=8 s")
    assert result.directory is not None
    log = result.directory / "run.mcap"
    (folder / "cut.mcap").write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    asked = "checks={signal: {topic: state.x, below: 1000 m, eventually_within: 7 s}}"
    found = check_log(folder / "cut.mcap", [asked])
    assert found.passed and 0.0 < found.until_s < 8.0 and "cut" in found.missing
    late = check_log(folder / "cut.mcap", [asked.replace("below", "above")])
    assert not late.passed and late.verdicts[0].found == "there is still time"
    (folder / "stump.mcap").write_bytes(log.read_bytes()[:2000])
    with pytest.raises(FleetError, match="holds no"):
        check_log(folder / "stump.mcap")


def test_a_run_that_goes_on_is_judged_from_there(folder: Path) -> None:
    first = run()
    assert first.directory is not None
    asked = "{name: spread, topic: state.z, below: 99 m, eventually_within: 100 ms}"  # after where it begins
    scenario, start = continuation(first.directory, 1_000_000_000, [f"checks.signal.5={asked}"])
    result = execute(scenario, Options(Path("runs"), in_process=True, quiet=True), wiring=Wiring(start=start))
    assert result.directory is not None
    verdicts = own(result)
    assert (verdicts[4].passed, verdicts[4].value) == (True, 0.0)
    assert verdicts[-1].found.startswith("1 s: [101, ")
    assert check_log(result.directory).verdicts == verdicts


def test_what_cannot_be_judged_is_said(folder: Path) -> None:
    result = run()
    assert result.directory is not None
    hide = {str(result.directory): "LOG"}
    check_refusals("repeat/judging a log", lambda change: check_log(result.directory, [change]), hide=hide)


def test_the_command(folder: Path) -> None:
    result = run()
    printed = invoke("check", result.directory, "-q")
    assert printed.exit_code == 1
    assert "FAIL  low: state.z below 1 m; found 1.0" in printed.output
    assert "judged up to t = 2 s of 2 s" in printed.output
    both = "checks={signal: [{name: deep, topic: state.z, below: 90 m}, {name: low, topic: state.z, below: 1 m}]}"
    lines = invoke("check", result.directory, "-q", "--set", both).output.splitlines()
    assert [line.split(":")[0] for line in lines[:2]] == ["FAIL  low", "pass  deep"]  # failed ones on top
    asked = "checks={signal: {name: deep, topic: state.z, below: 90 m}}"
    good = invoke("check", result.directory, "-q", "--json", "--set", asked)
    assert good.exit_code == 0, good.output
    document = json.loads(good.stdout)
    assert document["passed"] and [row["check"] for row in document["checks"]] == ["deep"]
    assert document["checks"][0]["moment"] is None


def test_a_check_of_a_stranger_needs_trust(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run()
    assert result.directory is not None
    log = result.directory.resolve()
    (folder / "strange_checks_here.py").write_text(MODULE)
    elsewhere = folder / "work"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    (elsewhere / "own_one_here.py").write_text(MODULE.replace("Packets", "Own"))
    typed = check_log(log, ['checks={"own_one_here:Own": {}}'])
    assert [verdict.check for verdict in typed.verdicts] == ["Own"]
    monkeypatch.chdir(folder)  # it lies here still, but is installed no more, and somebody else has run it
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "of somebody else"))
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(folder)])
    monkeypatch.delitem(sys.modules, "packets_seen_here")
    monkeypatch.setattr("world.plugins.trust._allowed", set())  # as in a new process
    with pytest.raises(ScenarioError, match=r"(?s)would run packets_seen_here\.py.* a log names it.*--trust"):
        check_log(log)
    assert "packets_seen_here" not in sys.modules


def test_a_signal_of_a_law_that_may_not_run_is_not_just_unknown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "strange_agent_here.py").write_text(AGENT)
    log = run("agent=strange_agent_here:Mine", "checks={}", "duration=200 ms").directory.resolve()
    asked = ["checks={signal: {topic: control.mine, equals: 3}}"]
    assert check_log(log, asked).passed
    elsewhere = folder / "work"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(folder)])
    monkeypatch.delitem(sys.modules, "strange_agent_here")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "of somebody else"))
    monkeypatch.setattr("world.plugins.trust._allowed", set())  # as in a new process

    def unknown(why: str) -> None:
        with pytest.raises(SignalCheckError, match=rf"no signal control\.mine; .* not known here, because of {why}"):
            check_log(log, asked)
        assert check_log(log, ["checks={signal: {topic: state.z, above: 0 m}}"]).passed

    unknown("strange_agent_here:Mine: there is no module 'strange_agent_here'")
    (elsewhere / "strange_agent_here.py").write_text(AGENT)
    unknown(r"strange_agent_here:Mine: would run strange_agent_here\.py, .*--trust")
    assert "strange_agent_here" not in sys.modules
