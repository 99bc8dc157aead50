"""Agents that end, begin again, are suspended or late: what each core makes of it, and the same bytes everywhere."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from failing_laws import failing
from failing_laws import module as module
from fault_histories import EVERYTHING, drive, told, world
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from msgspec.structs import astuple
from small_scenario import small

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.mcap.reader import digest
from fleet.repeat.recorded_run import script
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario, parse_scenario
from netem.lives import Absence, Lives
from netem.wire.messages import WorldFault
from world.lockstep import Lockstep, NavTo

END = 40
ABSENCES = st.lists(
    st.tuples(st.integers(0, END), st.one_of(st.none(), st.integers(1, 15))).map(
        lambda found: Absence(1, found[0], None if found[1] is None else found[0] + found[1])
    ),
    max_size=6,
)


@given(ABSENCES)
def test_lives_add_up(absences: list[Absence]) -> None:
    """Without an agent whenever an absence lasts; every end of such a time is another life."""
    lives = Lives(absences)
    missing = [any(a.begin <= k and (a.end is None or k < a.end) for a in absences) for k in range(END + 20)]
    assert [lives.lacks_agent(1, k) for k in range(END + 20)] == missing
    assert not any(lives.lacks_agent(2, k) for k in range(END))
    # One that ends where the next begins has lived for no tick, and counts.
    ends = {a.end for a in absences if a.end is not None and not any(b.begin < a.end < (b.end or 99) for b in absences)}
    assert [lives.incarnation(1, k) for k in range(END + 20)] == [
        sum(end <= k for end in ends) for k in range(END + 20)
    ]


def test_an_agent_that_dies_before_it_was_to_be_killed_comes_back_when_that_would_have() -> None:
    lives = Lives([Absence(1, 20, 30), Absence(1, 50, None)])
    lives.end(1, 10)
    assert lives.gaps(1) == [(10, 30), (50, None)]
    lives.end(1, 40)
    assert lives.gaps(1) == [(10, 30), (40, None)]
    lives.restart(1, None, 60)
    assert lives.gaps(1) == [(10, 30), (40, 60)]
    lives.restart(1, 7, 25)  # nothing began there
    assert lives.gaps(1) == [(10, 30), (40, 60)]


def kept(outs: list[Any], kind: str) -> list[Any]:
    return [out for out in outs if type(out).__name__ == kind]


def test_a_restart_is_a_new_incarnation_from_its_round_on() -> None:
    out = drive(Lockstep(world(absences=(Absence(2, 17, 30),)), frame_every=4), 50, {1, 2, 3, 4})
    navs = [(n.nav.tick, n.nav.incarnation) for n in kept(out, "NavTo") if n.id == 2]
    assert navs == [(k, 0) for k in range(17)] + [(k, 1) for k in range(30, 50)]
    assert [r.alive for r in kept(out, "Round")] == [(1, 2, 3, 4)] * 2 + [(1, 3, 4)] + [(1, 2, 3, 4)] * 2
    # Every fourth tick is told, and still when exactly somebody went and came.
    told_when = [(f.tick, *map(astuple, f.lives)) for f in kept(out, "Frame") if f.lives]
    assert told_when == [(20, (17, 2, False, False)), (32, (30, 2, True, False))]
    rows = {f.tick: f.vehicles[1] for f in kept(out, "Frame")}
    assert [bool(rows[k].command) for k in (16, 20, 28, 32)] == [True, False, False, True]
    assert rows[20].tau == (0.0, 0.0, 0.0)


def test_a_suspended_agent_gets_no_navs_and_its_vehicle_holds_the_last_command() -> None:
    pause = WorldFault("f", 13, 32, "pause", (2,), ())
    out = drive(Lockstep(world(faults=(pause,))), 50, {1, 2, 3, 4})
    assert [n.nav.tick for n in kept(out, "NavTo") if n.id == 2] == [*range(13), *range(32, 50)]
    assert [r.paused for r in kept(out, "Round")] == [(), (), (2,), (2,), ()]
    assert all(r.alive == (1, 2, 3, 4) for r in kept(out, "Round"))
    rows = {f.tick: f.vehicles[1] for f in kept(out, "Frame")}
    assert {rows[k].tau for k in range(13, 32)} == {(1.0, 0.0, 0.0)}
    assert not any(f.lives for f in kept(out, "Frame"))


def test_commands_of_a_slow_agent_take_effect_later() -> None:
    from netem.wire.messages import Command

    slow = WorldFault("f", 10, 20, "slow", (2,), (3.0,))
    lockstep = Lockstep(world(faults=(slow,)))
    seen: list[Any] = []
    todo: list[Any] = lockstep.grant(30)
    while todo:
        seen.append(out := todo.pop(0))
        if isinstance(out, NavTo):
            todo += lockstep.command(out.id, Command(0, out.nav.tick, (out.nav.tick / 100, 0.0, 0.0), ()))
    applied = [round(100 * f.vehicles[1].tau[0]) for f in kept(seen, "Frame") if f.tick < 30]
    # The command of tick 9 stands until the one of tick 10 is three ticks old.
    assert applied == [*range(10), 9, 9, 9, *range(10, 17), *range(20, 30)]


# --- whole runs ------------------------------------------------------------


def run(folder: Path, *overrides: str, in_process: bool = True) -> Result:
    checks = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived}"
    scenario = load_scenario("paper", [checks, *overrides])
    return execute(scenario, Options(folder, in_process=in_process, quiet=True))


@pytest.mark.parametrize("every", [1, 50])
def test_deaths_and_restarts_are_the_same_everywhere(every: int, tmp_path: Path) -> None:
    """Also when the log is so thin that it shows nothing of what happened in between."""
    overrides = ["duration=2 s", f"log.every={every} ticks", 'network.links={"2<->3": down}', EVERYTHING]
    alone, fleet = (run(tmp_path, *overrides, in_process=flag) for flag in (True, False))
    assert [alone.status, fleet.status] == [Status.PASS] * 2, (fleet.reason, fleet.lines, fleet.checks)
    assert (alone.directory / "run.mcap").read_bytes() == (fleet.directory / "run.mcap").read_bytes()
    assert fleet.values["deaths"] == {}
    kills = [(at, fault, action) for at, fault, action in told(alone.directory) if fault in ("f1", "f3", "f4")]
    assert kills == [
        (0.31, "f1", "begins"), (0.6, "f1", "ends"), (0.9, "f3", "begins"), (1.0, "f4", "begins"),
        (1.3, "f3", "ends"), (1.3, "f4", "ends"),
    ]  # fmt: skip


@pytest.mark.slow
def test_an_agent_that_is_killed_from_outside_may_be_restarted(tmp_path: Path) -> None:
    """It takes over at a round, is explained, and the script runs to the same digest."""
    checks = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, deaths: {at_most: 1}}"
    arguments = ["--duration", "6 s", "--speed", "4", "--set", checks, "--set", "profile=hardened"]
    with LiveRun(tmp_path / "runs", "paper", *arguments, "--set", "on_death=restart") as live:
        live.until_running()
        os.kill(live.role("agent 3").pid, signal.SIGKILL)
        assert live.status(60.0) == 0, live.said
        live.until_nobody_is_left()
        assert "another one takes over at t = " in " ".join(live.said.split())
        log = live.log
    (begin, fault, action), (end, *_) = told(log.parent)
    assert (fault, action, round(end * 10) == end * 10) == ("death-3", "begins", True)
    assert 0 < end - begin < 1.5
    again = execute(script(log), Options(tmp_path / "again", in_process=True, quiet=True))
    assert again.digest == digest(log)


def test_a_law_may_take_its_agent_with_it(module: Callable[[str], str], tmp_path: Path) -> None:
    """on_controller_error: die leaves the rest to on_death."""
    law = module(failing(31, "raise ValueError('enough')").replace("==", ">=", 1))
    overrides = ["duration=1 s", f"controller={law}:Law", "on_controller_error=die"]
    alone, fleet = (run(tmp_path, *overrides, in_process=flag) for flag in (True, False))
    # Nobody asked for these deaths, and the verdict says so.
    assert [alone.status, fleet.status] == [Status.CHECK_FAILED] * 2, (fleet.reason, fleet.lines)
    assert [[v.check for v in r.checks if not v.passed] for r in (alone, fleet)] == [["deaths"]] * 2
    assert (alone.directory / "run.mcap").read_bytes() == (fleet.directory / "run.mcap").read_bytes()
    assert told(fleet.directory) == [(0.31, "death-2", "begins"), (1.0, "death-2", "ends")]
    for result in (alone, fleet):
        assert list(result.values["deaths"]) == ["2"]
        assert any("ValueError: enough" in note for note in result.values["notes"])
    aborted = run(tmp_path, *overrides, "on_death=abort")
    assert (aborted.status, "ValueError: enough" in aborted.reason) == (Status.BROKEN, True)
    again = run(tmp_path, *overrides, "duration=4 s", "on_death=restart", "checks.deaths={at_most: 4}")
    assert again.status is Status.PASS
    assert len(again.values["deaths"]["2"]) == 4  # three more lives, and each dies at its first sample


# --- nemesis ---------------------------------------------------------------


def test_a_nemesis_is_a_timeline() -> None:
    nemesis = "nemesis={every: 100 ms, for: 50 ms, pick: [kill, down, partition, {link *: loss 40%}, {off: 2}]}"
    s = small("duration=2 s", "faults=[{at: 0 s, mute: 1, id: nemesis-2}]", nemesis)
    faults = s.spec.faults[1:]
    assert [f.at for f in faults] == [k * 100_000_000 for k in range(1, 20)]
    assert faults[1].id == "nemesis-2x"  # the name was taken
    assert s.spec.nemesis is None
    assert parse_scenario(s.to_yaml(), "again.yaml") == s
    assert small("duration=2 s", nemesis) == small("duration=2 s", nemesis)
    others = {small("duration=2 s", nemesis, f"seed={n}").to_yaml().split("faults:")[1] for n in range(9)}
    assert len(others) == 9
    drawn = {name for f in faults for name in ("kill", "down", "partition", "link", "off") if getattr(f, name)}
    assert len(drawn) >= 4
