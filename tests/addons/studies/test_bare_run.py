"""A bare run comes to the verdicts of the emulator, and leaves to it what it cannot judge."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
from marks import slow

from fleet.addons.studies.bare_run import bare_verdicts, fits
from fleet.addons.studies.one_run import Task, make_run
from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario

MOORED = """
title: moored
moored: true
vehicles: 5
duration: 20 s
graph: {shape: ring}
agent: {law: "fleet.protocols.election:Election", parameters: {vehicles: 5, lease_s: 2, quorum: fleet}}
network: {period: 100 ms, links: {"*": delay 100ms 60ms loss 10% duplicate 5%}}
nemesis:
  {mode: swarm, until: 15 s, pick: [partition, pause, kill, mute, deaf, slow, loss,
   {hold: {links: "*", order: reversed}}, {duplicate: {links: "2->*", after: 1 s}}]}
checks:
  fleet.protocols.checks:AtMostOneLeader: {per: fleet}
  fleet.protocols.checks:AgreeAfterHeal: {within: 9 s, quorum: fleet}
  signal:
    - {name: one-answer, topic: control.leader, agree_within: 9 s}
    - {name: somebody-leads, topic: control.leads, above: 0, sometimes: true}
    - {name: depth, topic: nav.z, below: 11 m}
"""


def moored(*changes: str) -> Scenario:
    return parse_scenario(MOORED, "m.yaml", changes)


@pytest.mark.parametrize("seed", [1, 2, 3, *slow(4, 5, 6, 7, 8)])
@pytest.mark.parametrize("changes", [(), ("network.period=200 ms", "tick=50 ms", "log={every: 2 ticks}")])
def test_verdicts_are_those_of_the_emulator(seed: int, changes: tuple[str, ...]) -> None:
    """In every word and number, of runs that fail, too."""
    scenario = moored(f"seed={seed}", *changes)
    assert fits(scenario)
    own = [verdict for verdict in run_loaded(scenario).checks if verdict.check not in ("tumbled", "deaths")]
    bare = bare_verdicts(scenario)
    assert bare == own


@pytest.mark.parametrize(
    "change",
    ["moored=false", "network=ideal", "expect=fail", "checks.max_age={below: 9 s}", "checks.signal=[]"],
)
def test_what_does_not_fit(change: str) -> None:
    more = ["nemesis=null", "tick=100 ms", "formation.shape=line", "reference={start: 0 0 5 m, velocity: 1 0 0 m/s}",
            "initial={scatter: 0 m, around: reference}"]  # fmt: skip
    assert fits(moored(change, *more)) is (change == "checks.signal=[]")


def test_a_law_that_fails_and_a_check_that_asks_for_more_are_left_to_the_emulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bare_run_law.py").write_text(
        "class Law:\n"
        "    signals = ()\n"
        "    def __init__(self, config): pass\n"
        "    def transmit(self, nav): return []\n"
        "    def decide(self, nav, deliveries):\n"
        "        if nav.tick == 50: raise RuntimeError('no')\n"
        "        return (0, 0, 0), {}\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    fails = ["agent=bare_run_law:Law", "checks={signal: [{name: deep, topic: nav.z, below: 11 m}]}"]
    asks = ["checks={signal: [{name: near, topic: error.formation_norm, below: 11 m}]}"]
    assert bare_verdicts(load_scenario_of(tmp_path, *fails)) == []
    scenario = load_scenario_of(tmp_path, *asks)
    assert fits(scenario) and bare_verdicts(scenario) == []
    row = make_run(Task("k", 0, 1, "m", scenario.to_undrawn_yaml(), 1e9, bare=True))
    assert row.passed and "near" in row.checks


@pytest.mark.parametrize(
    ("name", "changes"),
    [("nemesis", ["duration=4 s"]),
     *slow(*((name, ["duration=4 s"]) for name in ("average-naive", "navigation-aid", "rough-sea"))),
     ("election-slow", ["duration=14 s", "vehicles=3"])],
)  # fmt: skip
def test_a_run_of_a_search_has_the_verdicts_of_any_other_and_no_digest(name: str, changes: list[str]) -> None:
    """So has a run that is expected to fail and does."""
    text = load_scenario(name, [*changes, "seed=2"]).to_undrawn_yaml()
    bare, whole = (make_run(Task("k", 0, 2, name, text, inf, bare=one)) for one in (True, False))
    assert bare.checks == whole.checks and (bare.status, bare.passed) == (whole.status, whole.passed)
    assert bare.digest is None and whole.digest


def load_scenario_of(folder: Path, *changes: str) -> Scenario:
    (folder / "m.yaml").write_text(MOORED)
    return load_scenario(folder / "m.yaml", changes)


def test_a_row_of_a_bare_run_has_its_checks_and_what_was_reached() -> None:
    row = make_run(Task("k", 0, 1, "m", moored("seed=1").to_undrawn_yaml(), 1e9, bare=True))
    assert row.passed and row.digest is None and row.numbers == {"sometimes.somebody-leads": 1.0}
    assert set(row.checks) == {"AtMostOneLeader", "AgreeAfterHeal", "one-answer", "depth"}


def test_a_bare_run_ends_when_it_takes_too_long() -> None:
    row = make_run(Task("k", 0, 1, "m", moored("seed=1").to_undrawn_yaml(), 1e-6, bare=True))
    assert row.status == "failed" and "took longer" in row.reason
