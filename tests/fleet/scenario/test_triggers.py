"""Triggers: which moment begins a fault, whose fault it is then, and that the run is that of ordinary faults."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import pytest
from marks import slow
from rich.console import Console as Terminal
from tool import invoke

from fleet.addons.studies.bare_run import _BareRun
from fleet.checks.triggers import Triggers
from fleet.checks.values import LoggedValues
from fleet.errors import ScenarioError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.triggered import resolve_triggers
from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy

ELECTION = """
title: triggers
moored: true
vehicles: 4
duration: 20 s
graph: {shape: ring}
agent: {law: "fleet.protocols.election:Election", parameters: {vehicles: 4, lease_s: 2, quorum: fleet}}
network: {period: 100 ms, links: {"*": delay 100ms 30ms loss 10%}}
checks:
  fleet.protocols.checks:AtMostOneLeader: {per: fleet}
triggers:
"""
LEADS = '  - {when: {topic: control.leads, above: 0%s}, %s fault: {partition: "itself / others"}}\n'
S = 10**9


def election(triggers: str, *changes: str) -> Scenario:
    return parse_scenario(ELECTION + triggers, "t.yaml", changes, policy=Policy(imports=True))


def begun(triggers: str, samples: Sequence[Sequence[float | None]], *changes: str) -> list[tuple[int, str]]:
    """Tick and target of the faults that reports of `leads` begin: a row of samples for each tick, None without one."""
    running = Triggers(election(triggers, *changes))
    found = []
    for tick, row in enumerate(samples):
        known = {(i, "control"): (value, *[0.0] * 5) for i, value in enumerate(row, 1) if value is not None}
        found += [(fault.at // (S // 10), str(getattr(fault, fault.kind.name)))
                  for fault in running.look(LoggedValues(tick, known))]  # fmt: skip
    return found


RISES = [(0, 0, 0, 0), (0, 1, 0, 0), (0, 1, 0, 0), (0, 0, 0, 0), (1, 0, 1, 0)]


@pytest.mark.parametrize(
    ("more", "times", "found"),
    [
        ("", "", [(2, "2 / 1,3,4")]),  # a round later
        ("", "wait: 500 ms,", [(6, "2 / 1,3,4")]),
        ("", "nth: 2,", [(5, "1 / 2,3,4")]),  # of two in one tick the lower number first
        ("", "nth: 3,", [(5, "3 / 1,2,4")]),
        ("", "nth: 4,", []),
        (", vehicles: 3", "", [(5, "3 / 1,2,4")]),
        (", after: 200 ms", "", [(3, "2 / 1,3,4")]),  # what holds at the first look counts
        (", after: 300 ms", "", [(5, "1 / 2,3,4")]),
        (", before: 100 ms", "", []),
    ],
)
def test_when_a_condition_begins_to_hold(more: str, times: str, found: list[tuple[int, str]]) -> None:
    assert begun(LEADS % (more, times), RISES) == found


def test_a_change_needs_a_sample_before_and_each_life_begins_anew() -> None:
    changes = "  - {when: {topic: control.leads, changes: true}, nth: %d, fault: {kill: itself}}\n"
    samples = [(5, 0, 0, 0), (5, 0, None, 0), (6, 0, 7, 0), (6, 1, 7, 0)]
    assert begun(changes % 1, samples) == [(3, "1")] and begun(changes % 2, samples) == [(4, "2")]


def test_words_stand_for_numbers() -> None:
    for fault, text in (
        ("{kill: others}", "1,3,4"), ("{mute: neighbours}", "1,3"), ("{down: itself->*}", "2->*"),
        ('{partition: "isolate:itself"}', "isolate:2"),
    ):  # fmt: skip
        assert begun(f"  - {{when: {{topic: control.leads, above: 0}}, fault: {fault}}}\n", RISES)[0][1] == text


BOTH = LEADS % ("", "for: 4 s, wait: 200 ms,") + LEADS % ("", "nth: 2, for: 1 s,") + (
    "  - {id: held, when: {topic: control.candidate, changes: true, after: 9 s}, for: 2 s, fault: {hold: itself->*}}\n"
    "  - {when: {topic: control.known, below: 4, after: 4 s}, for: 500 ms, wait: 1 s, fault: {kill: itself}}\n"
    "  - {when: {topic: control.known, below: 2, after: 5 s}, for: 1 s, fault: {pause: itself}}\n"
)  # fmt: skip


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
@pytest.mark.parametrize("changes", [(), *slow((("tick=50 ms", "log={every: 2 ticks}", "network.period=200 ms"),))])
def test_the_run_is_that_of_the_faults_at_their_times(seed: int, changes: tuple[str, ...]) -> None:
    """In the emulator and in a bare run; and the faults are those that the log of the run has."""
    scenario = election(BOTH, f"seed={seed}", *changes)
    ordinary = resolve_triggers(scenario)
    assert not ordinary.spec.triggers and len(ordinary.spec.faults) >= 4
    assert resolve_triggers(ordinary) is ordinary
    result = run_loaded(scenario)
    assert result.digest == run_loaded(ordinary).digest
    bare = _BareRun(scenario)
    verdicts = bare.to_end(None)
    assert bare.triggers is not None and bare.triggers.begun == ordinary.spec.faults
    assert verdicts == [verdict for verdict in result.checks if verdict.check not in ("tumbled", "deaths")]


def test_the_command_says_what_triggers_begin_and_the_run_itself_prints_nothing_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.yaml").write_text(ELECTION + LEADS % ("", "for: 1 s,"))
    asked = ("run", tmp_path / "t.yaml", "--in-process", "--duration", "4 s", "--out", tmp_path, "--trust")
    said = invoke(*asked).stderr.splitlines()
    planned, begun_at = [line for line in said if "(id t1)" in line]
    assert planned.startswith("fault 100 ms after control.leads above 0: partition itself / others")
    assert begun_at.startswith("fault from 2") and begun_at.endswith("(id t1), 100 ms after control.leads above 0")
    assert "(id t1)" not in invoke(*asked, "--quiet").stderr
    terminal = Terminal(file=io.StringIO())
    execute(election(LEADS % ("", "for: 1 s,"), "duration=4 s"), Options(tmp_path, in_process=True), terminal)
    assert "(id t1)" not in terminal.file.getvalue()  # type: ignore[attr-defined]
    assert capsys.readouterr().err == ""


def test_a_record_of_the_scenario_keeps_its_triggers() -> None:
    scenario = election(BOTH)
    assert parse_scenario(scenario.to_yaml(), "t.yaml").spec == scenario.spec


def test_a_fault_that_acts_on_nothing_is_left_out() -> None:
    """Vehicle 1 sends to nobody here, so no link of its own can be cut."""
    one_way = ("graph={edges: {1->2: 1, 2->3: 1, 3->4: 1}}", "agent.parameters.quorum=side")
    scenario = election("  - {when: {topic: control.leads, above: 0, vehicles: 4}, fault: {down: itself->*}}\n",
                        *one_way)  # fmt: skip
    assert resolve_triggers(scenario).spec.faults == []


ONE_WAY = "graph={edges: {1->2: 1, 2->3: 1, 3->4: 1}}"


@pytest.mark.parametrize(
    ("fault", "leader", "found"),
    [
        ("{down: itself->*}", 4, []),  # it sends to nobody, and vehicle 1, the first that is looked at, never led
        ("{down: itself->*}", 3, [(2, "3->*")]),
        ("{kill: neighbours}", 1, []),  # it hears nobody
        ("{kill: neighbours}", 2, [(2, "1")]),
    ],
)
def test_a_fault_that_acts_on_nothing_is_left_to_no_other_vehicle(
    fault: str, leader: int, found: list[tuple[int, str]]
) -> None:
    samples = [tuple(float(leads and i == leader) for i in range(1, 5)) for leads in (False, True, True, False, True)]
    trigger = f"  - {{when: {{topic: control.leads, above: 0}}, fault: {fault}}}\n"
    assert begun(trigger, samples, ONE_WAY) == found


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("triggers.1.wait=50 ms", "triggers.1.wait"),
        ("triggers.1.for=1 ms", "triggers.1.for"),
        ("triggers.1.fault={kill: 9}", "triggers.1.fault.kill"),
        ("triggers.1.fault={kil: itself}", "triggers.1.fault.kil"),
        ("triggers.1.fault={at: 3 s, kill: itself}", "triggers.1.fault.at"),
        ("triggers.1.fault={kill: itself, mute: itself}", "triggers.1.fault"),
        ("triggers.1.when.topic=control.foo", "triggers.1.when.topic"),
        ("triggers.1.when.below=3", "triggers.1.when.below"),
        ("triggers.1.when={topic: control.leads}", "triggers.1.when.topic"),
        ("faults=[{id: t1, at: 1 s, kill: 1}]", "triggers.1.id"),
        ("network=ideal", "triggers"),
    ],
)
def test_a_mistake_is_at_its_key(change: str, key: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        election(LEADS % ("", ""), change)
    assert key in [problem.key for problem in caught.value.problems]
