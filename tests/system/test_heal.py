"""Heals at awkward moments: of what has just begun, of agents that are to start again, of what is beyond healing."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import pytest
from hand import Hand
from live import LiveRun
from waiting import wait_for

from fleet.execution.connection import RemoteError, ask
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.mcap.reader import digest
from fleet.repeat.recorded_run import script
from fleet.scenario.loading import load_scenario
from netem.lives import Absence
from netem.wire.messages import Command, Frame
from world.lockstep import Lockstep, NavTo

CHECKS = "checks={ledger: balanced, tumbled: waived, deaths: waived}"
CALM = ["--speed", "1", "--duration", "6 s", "--set", "profile=hardened", "--set", CHECKS]


def runs_again(run: LiveRun, out: Path) -> None:
    with suppress(RemoteError):  # it is over
        Hand(out).clock("speed", 1e6)
    assert run.status(90.0) == 0, run.printed
    again = execute(script(run.log), Options(out=out / "again", in_process=True, quiet=True))
    assert digest(run.log) == again.digest


@pytest.mark.slow
def test_what_is_healed_at_the_tick_at_which_it_began_never_was(tmp_path: Path) -> None:
    with LiveRun(tmp_path, "paper", *CALM).until_running() as run:
        hand = Hand(tmp_path)
        hand.pause_at_round()
        hand.inject(mute="3")
        assert hand.heal() == ["live-1"]
        agent = run.role("agent 2")
        hand.inject(kill="2")  # its process is ended at once, so it must come back
        wait_for(lambda: not agent.is_running(), 60.0, "the end of agent 2")
        assert hand.heal() == ["live-2"]
        hand.clock("resume")
        runs_again(run, tmp_path)


@pytest.mark.slow
def test_the_end_of_a_kill_moves_while_it_lasts(tmp_path: Path) -> None:
    """The process that takes over is told its first tick, so it must not be there before that is certain."""
    with LiveRun(tmp_path, "paper", *CALM).until_running() as run:
        hand = Hand(tmp_path)
        sooner = hand.inject(kill="3", **{"for": "3 s"})["id"]
        hand.inject(kill="1", **{"for": "2 s"})
        hand.until(hand.now() + 1.0)
        assert hand.heal(sooner) == [sooner]
        hand.inject(kill="1", **{"for": "2.5 s"})
        runs_again(run, tmp_path)


@pytest.mark.slow
def test_a_tumbled_vehicle_is_not_healed(tmp_path: Path) -> None:
    # A moment that its restoring moment of 1 kN m holds at 17 degrees, with its actuators off.
    wrench = '[{at: 500 ms, for: 5 s, wrench: {vehicles: "2", pitch_moment: 300 N m}}, {at: 500 ms, off: "2"}]'
    heavy = ["--set", "vehicle={beta_b: 1 kN m, beta_q: 300 kg m^2/s, tumble_pitch: 10 deg}"]
    with LiveRun(tmp_path, "paper", *CALM, *heavy, "--set", f"faults={wrench}").until_running() as run:
        hand = Hand(tmp_path)
        wait_for(lambda: any(e["id"] == "tumbled-2" for e in ask(hand.run, "faults")["events"]), 60.0, "a tumble")
        with pytest.raises(RemoteError, match="tumbled-2 is no fault"):
            hand.heal("tumbled-2")
        assert "tumbled-2" not in hand.heal()
        runs_again(run, tmp_path)


@pytest.mark.slow
def test_live_faults_beside_those_of_a_script(tmp_path: Path) -> None:
    """A kill that began at zero is healed alone, ids of the script are not given again, no speed breaks the console."""
    faults = (
        '[{at: 0 s, id: a, kill: "1"}, {at: 500 ms, id: b, kill: "1"}, {at: 0 s, for: 1 s, id: live-1, mute: "4"}, '
        '{at: 0 s, for: 1 s, id: death-3, mute: "4"}]'
    )
    with LiveRun(tmp_path, "paper", *CALM, "--set", f"faults={faults}").until_running() as run:
        hand = Hand(tmp_path)
        assert hand.heal("a") == ["a"]
        assert hand.inject(mute="2")["id"] == "live-2"
        run.role("agent 3").kill()
        for speed in (float("inf"), float("nan"), 0.0, -1.0):
            with pytest.raises(RemoteError, match="the clock knows"):
                hand.clock("speed", speed)
        hand.clock("speed", 1e6)
        runs_again(run, tmp_path)
        assert "death-3-2" in [fault.id for fault in script(run.log).spec.faults]
        assert json.loads((run.directory / "result.json").read_text("utf-8"))["exit"] == 0


def lives_told(vehicle: int, absences: list[tuple[int, int | None]], late: bool) -> list[tuple[int, bool]]:
    """(tick, begins) of all that a world of silent agents tells of one vehicle; `late`: told when it is there."""
    scenario = load_scenario("paper", ["duration=1 s"])
    world = Lockstep(scenario.world_config)
    told: list[tuple[int, bool]] = []

    def go_on(until: int) -> None:
        waiting = list(world.grant(until))
        while waiting:
            out = waiting.pop(0)
            if isinstance(out, NavTo):
                tau, size = (0.0, 0.0, 0.0), scenario.layout(out.id).size
                waiting += world.command(out.id, Command(out.nav.incarnation, out.nav.tick, tau, (0.0,) * size))
            elif isinstance(out, Frame):
                told.extend((life.tick, life.begins) for life in out.lives if life.vehicle == vehicle)

    for begin, end in absences:
        if late:
            go_on(begin)
        world.state.lives.add(Absence(vehicle, begin, end))
    go_on(100)
    return told


@pytest.mark.parametrize("late", [False, True])
def test_an_agent_that_ended_before_it_began_is_told(late: bool) -> None:
    """Otherwise nothing would say that its vehicle went on without one."""
    told = lives_told(2, [(20, 30), (30, 40)], late)
    assert told == [(20, False), (30, True), (30, False), (40, True)]


def test_an_agent_that_ended_at_its_first_tick_is_told_in_this_order() -> None:
    world = Lockstep(load_scenario("paper", ["duration=1 s", "vehicles=1"]).world_config)
    world.state.lives.add(Absence(1, 0, 10))
    lives = [life for out in world.grant(11) if isinstance(out, Frame) for life in out.lives]
    lives += [life for out in world.end(1, 1, 20) if isinstance(out, Frame) for life in out.lives]
    lives += [life for out in world.grant(30) if isinstance(out, Frame) for life in out.lives]
    assert [(life.tick, life.begins) for life in lives] == [(0, False), (10, True), (10, False)]
