"""Checks in Python: what they see, and that whatever they do wrong becomes their verdict and names the line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from fed_checks import FAULTS, fate, fed
from refusals import check_refusals
from small_scenario import SMALL, small

import fleet.checks.python_check
from fleet.checks.python_check import CheckError
from fleet.errors import ScenarioError
from fleet.execution.whole_run import run_loaded
from fleet.result.verdict import Verdict
from fleet.scenario.loading import load_scenario

HEAD = "from fleet.checks.api import Failure, seconds\n\n\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a module `own_checks_here`, which may be imported."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_checks_here", raising=False)
    return tmp_path / "own_checks_here.py"


def verdict(module: Path, code: str, parameters: str = "{}", **more: object) -> Verdict:
    module.write_text(HEAD + code)
    depth = lambda i, t: 9.0 if i == 2 and t >= 1.0 else 5.0  # noqa: E731
    (found,) = fed(f'"own_checks_here:Check": {parameters}', depth, **more)  # type: ignore[arg-type]
    return found


SEES = '''\
class Check:
    """Sees what is there"""

    def __init__(self, facts, *, until="0 s"):
        assert (facts.vehicles, facts.tick, facts.duration, facts.begin) == (3, 0.01, 4.0, 0.0)
        assert (1, 2) in facts.links and facts.units[1]["nav.z"] == "m"
        self.until, self.seen, self.packets = seconds(until), [], []

    def step(self, tick):
        assert [vehicle.id for vehicle in tick.vehicles] == [1, 2, 3]
        one = tick.vehicles[1]
        assert one["nav.x"] == 0.0 and one["state.z"] is None and one["control.u_err"] is None
        self.packets += [(packet.src, packet.dst, packet.fate, packet.sent) for packet in tick.packets]
        now = tuple(fault.id for fault in tick.faults), tuple(v.id for v in tick.vehicles if not v.alive)
        if now not in self.seen:
            self.seen.append(now)

    def verdict(self):
        return f"{self.seen} {self.packets}"
'''


def test_a_check_sees_faults_lives_and_packets(module: Path) -> None:
    faults = "faults=[{id: cut, at: 1 s, for: 1 s, down: 1->2}, {id: gone, at: 1500 ms, for: 1 s, kill: 3}]"
    found = verdict(module, SEES, "{until: 2 s}", faults=faults, fates=[fate(1, 2, 0), fate(1, 2, 5, "loss", final=5)])
    seen = "[((), ()), (('cut',), ()), (('cut', 'gone'), (3,)), (('gone',), (3,))]"
    packets = "[(1, 2, 'delivered', 0.0), (1, 2, 'loss', 0.05)]"
    words = "Sees what is there, until 2 s"
    signals = ("nav.x", "state.z", "control.u_err")
    assert found == Verdict("Check", True, words, f"{seen} {packets}", 0.0, 0.0, "times", signals=signals)


DEEP = """\
class Check:
    def __init__(self, facts): pass
    def step(self, tick):
        for one in tick.vehicles:
            one["control.u_err"]
            if one["nav.z"] > 8: return Failure("too\\n deep", (one.id,), {"z": one["nav.z"]})
"""


def test_a_long_parameter_is_cut_where_that_is_seen(module: Path) -> None:
    code = "class Check:\n    def __init__(self, facts, *, places, n): pass\n    def step(self, tick): pass\n"
    found = verdict(module, code, f"{{places: {[[1, 2, 3]] * 20}, n: 2}}")
    assert found.asked.endswith("[1, 2, 3], [1, 2..., n 2")


def test_a_failure_has_its_moment(module: Path) -> None:
    fates = [fate(1, 2, 0), fate(1, 2, 50), fate(1, 2, 99, "down", final=99)]
    found = verdict(module, DEEP, faults=FAULTS, fates=fates)
    moment = found.moment
    assert found.signals == ("control.u_err", "nav.z")
    assert not found.passed and moment is not None and moment.message is not None
    assert (moment.tick, moment.at_s, moment.vehicles, moment.values, moment.faults) == (
        100,
        1.0,
        [2],
        {"z": 9.0},
        ["cut"],
    )
    assert (moment.message.fate, moment.message.heard_s) == ("down", 0.5)
    assert found.found == (
        "too deep (vehicle 2), z 9 at 1 s; fault cut active; the last message that vehicle 2 missed: 1->2, sent at "
        "0.99 s, down; it had the last before from 0.5 s"
    )


def test_a_failure_calls_nodes_by_their_names(module: Path) -> None:
    found = verdict(module, DEEP, faults=FAULTS, fates=[fate(1, 2, 0)], names="names=[north, south, shore]")
    assert found.found.startswith(
        "too deep (south), z 9 at 1 s; fault cut active; the last message that south received"
    )


def test_a_signal_that_is_missing_is_missed_by_name(module: Path) -> None:
    found = verdict(module, DEEP.replace("control.u_err", "no.such"), names="names=[north, south, shore]")
    assert "north has no signal 'no.such'" in found.found and "vehicle" not in found.found


def test_the_end_may_show_a_failure(module: Path) -> None:
    code = "class Check:\n    def __init__(self, facts): pass\n    def step(self, tick): pass\n"
    never = code + "    def verdict(self): return Failure('never a leader', (1, 2))\n"
    found = verdict(module, never)
    assert (found.passed, found.found, found.moment, found.value) == (
        False,
        "never a leader (vehicles 1, 2)",
        None,
        1.0,
    )
    going_on = verdict(module, never, until_s=1.0)
    assert (going_on.outcome, going_on.value) == (None, None)


def test_the_end_may_be_too_early_to_tell(module: Path) -> None:
    code = "from fleet.checks.api import NotJudged\nclass Check:\n    def __init__(self, facts): pass\n"
    code += "    def step(self, tick): pass\n    def verdict(self): return NotJudged('too early')\n"
    found = verdict(module, code)
    assert (found.outcome, found.failed, found.mark, found.found) == (None, False, "not judged", "too early")


STEP = "class Check:\n    def __init__(self, facts): self.n = 0\n    def step(self, tick):\n        "


BODIES = (
    "raise ValueError('why not')", "raise SystemExit", "tick.vehicles[0]['nav.zz']", "return True", "return Failure(3)",
    "return Failure('x', 3)", "return Failure('x', (9,))", "return Failure('x', (), {'a': 'b'})", "while True: pass",
    "return None\n    def verdict(self): return 1 / 0",
)  # fmt: skip


def test_a_broken_check_is_no_pass(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet.checks.python_check, "BUDGET_S", 0.05)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def check(body: str) -> None:
        sys.modules.pop("own_checks_here", None)
        found = verdict(module, STEP + body + "\n")
        assert found.moment is None if "verdict" in body else found.moment is not None and found.moment.tick == 0
        if not found.passed and found.value is None:
            raise RuntimeError(found.found)

    check_refusals("checks/broken", check, BODIES)


def test_a_check_whose_process_is_suspended_is_not_broken(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it had been slow it was broken, and its verdict depended on what else the machine did."""
    monkeypatch.setattr(fleet.checks.python_check, "BUDGET_S", 0.1)
    body = "self.n += 1; import time; time.sleep(0.25 if self.n == 1 else 0.0)"
    assert verdict(module, STEP + body + "\n").passed
    monkeypatch.setattr(fleet.checks.python_check, "PATIENCE", 2)
    assert "longer than its budget" in verdict(module, STEP + body + "\n").found


EARLY = """\
class Check:
    def __init__(self, facts): self.seen = []
    def step(self, tick):
        if tick.t > 1: self.seen.append(tick.t)
    def verdict(self): return f"{max(self.seen):g} s"
"""


def test_a_verdict_that_comes_too_early_changes_nothing(module: Path) -> None:
    asked_once, asked_often = verdict(module, EARLY), verdict(module, EARLY, at_once=False)
    assert asked_once.passed and asked_once.found == "4 s"
    assert asked_often == asked_once


DIES = """\
class Check:
    def __init__(self, facts): self.seen = []
    def step(self, tick):
        self.seen.append((tick.t, [one.id for one in tick.vehicles if one.alive], [one.id for one in tick.faults]))
    def verdict(self): return str(self.seen[-1])
"""


def test_what_lasts_to_the_end_is_there_at_the_last_tick(module: Path) -> None:
    found = verdict(module, DIES, faults="faults=[{id: gone, at: 1 s, kill: 2}]")
    assert found.found == "(4.0, [1, 3], ['gone'])"


NOTHING = "class Check:\n    def __init__(self, facts): raise ValueError('no')\n    def step(self, tick): pass\n"


def test_one_that_cannot_be_made_is_found_before_the_run(module: Path) -> None:
    with pytest.raises(CheckError, match=r"Check: Check raised ValueError: no \(own_checks_here.py:5\)"):
        verdict(module, NOTHING)


def test_what_cannot_be_used_is_refused_with_its_line(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def load(code: str, key: str = "own_checks_here:Check") -> None:
        sys.modules.pop("own_checks_here", None)
        module.unlink(missing_ok=True)
        if code:
            module.write_text(HEAD + code)
        scenario = module.with_name("here.yaml")
        scenario.write_text(SMALL + f'checks:\n  "{key}": {{x: 1}}\n')
        load_scenario(scenario)

    cases = ["", "x = 1\n", "1 / 0\n", "class Check: pass\n", "class Check:\n    def step(self): pass\n", DEEP]
    check_refusals("checks/useless", load, [*cases, (DEEP, "own checks:Check")], hide={str(module.parent): "HERE"})


def test_a_check_that_nobody_allowed_does_not_run(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = module.parent / "elsewhere"
    folder.mkdir()
    (folder / "other_checks_there.py").write_text("raise SystemExit('this ran')\n")
    (folder / "here.yaml").write_text(SMALL + 'checks: {"other_checks_there:Check": {}}\n')
    (module.parent / "work").mkdir()
    monkeypatch.chdir(module.parent / "work")
    with pytest.raises(ScenarioError, match=r"would run .*other_checks_there.py, which is not installed"):
        load_scenario(folder / "here.yaml")


def test_a_real_run_is_kept_whatever_its_check_does(module: Path) -> None:
    module.write_text(HEAD + STEP + "if tick.t > 0.5: raise ValueError('late')\n")
    scenario = module.with_name("here.yaml")
    scenario.write_text(SMALL + "checks:\n  own_checks_here:Check:\n")
    result = run_loaded(load_scenario(scenario))
    assert result.status.name == "CHECK_FAILED"
    row = next(check for check in result.values["checks"] if check["check"] == "Check")
    assert "raised ValueError: late" in row["found"] and row["moment"]["at_s"] == 0.51
    assert result.digest == run_loaded(small()).digest  # a check changes no byte
