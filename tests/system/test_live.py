"""The operator's hand on a running fleet: faults injected at arbitrary moments, the clock held and paced, and a script
of it all that runs to the same digest."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path
from typing import Any

import pytest
from hand import held
from live import READY_S, LiveRun
from tool import tool
from waiting import wait_for

from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.mcap.reader import digest
from fleet.repeat.recorded_run import script
from fleet.scenario.loading import parse_scenario

TICK_NS = 10_000_000
CHECKS = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, deaths: waived}"
SLOW = ["--speed", "1", "--set", CHECKS]


# --- the clock -------------------------------------------------------------


def live_clock(speed: float | None = None) -> LiveClock:
    return LiveClock(GrantPolicy(1000, TICK_NS, 10, 1, speed), 100.0)


def test_a_paused_clock_grants_nothing_more() -> None:
    clock = live_clock()
    assert clock.until(0, 100.0) == 51
    clock.pause(51)
    assert [clock.until(k, 101.0) for k in (10, 50, 900)] == [51, 51, 51]
    clock.step(51, 5)
    assert (clock.until(51, 102.0), clock.describe()) == (56, "paused")
    clock.resume()
    assert clock.until(56, 103.0) == 107


def test_a_change_of_speed_counts_from_where_it_is() -> None:
    """No jump: what passed at the old speed, or in a pause, is not made up for."""
    clock = live_clock(1.0)
    assert clock.until(900, 101.0) == 101
    clock.pause(101)
    assert clock.until(900, 150.0) == 101
    clock.resume()
    assert clock.until(900, 150.0) == 102
    clock.set_speed_limit(102, 2.0)
    assert clock.until(900, 151.0) == 303
    clock.set_speed_limit(303, None)
    assert clock.until(900, 151.0) == 951


# --- live runs -------------------------------------------------------------


def test_every_live_action_is_a_script_line(tmp_path: Path) -> None:
    """Faults at moments that nobody chose, one healed early, a kill: the exported scenario gives the same digest."""
    out = tmp_path / "runs"
    rng = random.Random()  # arbitrary on purpose: it must hold whenever the faults come
    # The clock is held but for some ticks before each fault, which so comes while they go by or just after them.
    with LiveRun(out, "paper", "--duration", "7 s", *SLOW, "--speed", "0.1", "--set", "profile=hardened") as live:
        hand = held(live)
        answers = []
        for arguments in (
            ["link", "1<->2", "delay 60ms 20ms loss gemodel 10% 40%", "--for", "1500ms"],
            ["partition", "halves", "--id", "split"],
            ["hold", "3->4", "--id", "kept"],
            ["mute", "3", "--for", "1s"],
            ["stuck", "1", "--for", "300ms"],
            ["noise", "vehicles=1,2", "position_noise=5 cm", "--id", "fog"],
            ["current", "0.1 0 0 m/s"],
            ["kill", "4", "--id", "crash"],
            ["pause", "2", "--for", "200ms"],
            ["slow", "vehicles=1", "by=3 ticks", "--for", "500ms"],
            ["clock", "vehicles=3", "step=-30ms", "drift=500 ppm", "--for", "700ms", "--id", "watch"],
        ):
            hand.step(rng.randrange(1, 40))
            answers.append(tool(out, "inject", *arguments))
        hand.step(rng.randrange(1, 40))
        healed = tool(out, "heal", "split")
        hand.step(rng.randrange(1, 40))
        released = tool(out, "heal", "kept")
        listed = tool(out, "status", "--all")
        # A step goes on in its own time, and the agent with it.
        wait_for(lambda: re.search(r"^4 +no agent ", tool(out, "status").stdout, re.MULTILINE), READY_S, "its death")
        reborn = tool(out, "heal", "crash")
        again_dead = tool(out, "inject", "kill", "2", "--for", "5s")
        # Its vehicle is not waited for at the tick at which the agent was to come back, but earlier.
        hand.step(60)
        hand.until(float(again_dead.stdout.partition("from t = ")[2].split()[0]) + 0.2)
        early = tool(out, "heal", "live-7")
        assert tool(out, "clock", "speed", "max").exit_code == 0
        assert tool(out, "clock", "resume").exit_code == 0
        assert live.status(60.0) == 0, live.said
        log = live.log
    assert [a.exit_code for a in answers] == [0] * 11, [a.stderr for a in answers]
    name = log.parent.name
    assert answers[0].stdout.startswith(f"{name}: live-1: link 1<->2: delay 60ms 20ms loss gemodel 10% 40%")
    assert healed.stdout.startswith(f"{name}: healed split at t = ")
    assert released.stdout.startswith(f"{name}: healed kept at t = ")
    names = {"live-1", "split", "kept", "live-2", "live-3", "fog", "live-4", "crash", "live-5", "live-6", "watch"}
    assert set(re.findall(r"^fault ([\w-]+): ", listed.stdout, re.MULTILINE)) == names
    assert reborn.stdout.startswith(f"{name}: healed crash at t = ")
    assert early.stdout.startswith(f"{name}: healed live-7 at t = ")
    assert again_dead.stdout.startswith(f"{name}: live-7: kill 2, from t = ")
    again = script(log)
    assert {*names, "live-7"} <= {fault.id for fault in again.spec.faults}  # a vehicle may be lost besides
    assert parse_scenario(again.to_yaml(), "again.yaml") == again
    result = execute(again, Options(tmp_path / "again", in_process=True, quiet=True))
    assert result.digest == digest(log)


def test_who_asks_for_the_impossible_is_refused_and_stop_ends_the_run(tmp_path: Path) -> None:
    out = tmp_path / "runs"
    with LiveRun(out, "paper", "--duration", "60 s", *SLOW) as live:
        held(live)
        done = tool(out, "inject", "link", "1->3", "loss 3%")
        assert (done.exit_code, "the graph has no link 1->3; links: 2->1, 1->2" in done.stderr) == (2, True), done
        assert tool(out, "stop").exit_code == 0
        live.ends(130)
        assert "stopped: the operator asked for it" in live.said
    done = tool(out, "status")
    assert (done.exit_code, "is no live run" in done.stderr) == (3, True)


@pytest.mark.slow
def test_two_runs_do_not_disturb_each_other(tmp_path: Path) -> None:
    """Started in the same second, side by side: a fault in one is none in the other."""
    out = tmp_path / "runs"
    arguments = ["paper", "--duration", "5 s", *SLOW]
    with LiveRun(out, *arguments) as one, LiveRun(tmp_path / "other", *arguments) as other:
        hands = [held(one), held(other)]
        assert tool(out, "inject", "partition", "halves").exit_code == 0
        for hand in hands:
            hand.clock("speed")
            hand.clock("resume")
        assert (one.status(60.0), other.status(60.0)) == (0, 0)
        results: list[Any] = [json.loads((live.directory / "result.json").read_text()) for live in (one, other)]
    lost = [sum(account["lost"].get("partition", 0) for account in r["ledger"].values()) for r in results]
    assert lost[0] > 0
    assert lost[1] == 0
