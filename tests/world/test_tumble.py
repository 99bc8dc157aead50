"""When a vehicle tumbles, and that everybody sees it: world, log, verdict, resumed runs, recordings."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import NU0, PARAMS, TAU_MAX, world_config

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.open_log import open_log
from fleet.repeat.resume import continuation
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Frame, Tumble
from world.config import VehicleSetup
from world.lockstep import Lockstep
from world.tumble import HYSTERESIS_RAD, LIMIT_RAD, tumbles

CALM = "checks={ledger: balanced, middleware_loss: {at_most: 0}}"


def spells(theta: list[float], q: list[float], h: float) -> int:
    """How often it begins along samples of pitch and pitch rate."""
    tumbled, count = False, 0
    for before, after in pairwise(zip(theta, q, strict=True)):
        now = tumbles(tumbled, LIMIT_RAD, before, after, h)
        count += now and not tumbled
        tumbled = now
    return count


@given(st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from((0.01, 0.05, 0.1)))
def test_where_ticks_fall_does_not_matter(phase: float, over: float, h: float) -> None:
    """A pitch that peaks three times, above the limit or below it by at least 0.1 deg: counted, or not."""
    amplitude = LIMIT_RAD + math.radians(0.1 if over >= 0.0 else -0.1) + math.radians(over)
    times = [h * (k + phase) for k in range(int(3 * math.tau / h))]
    theta = [amplitude * 0.5 * (1.0 - math.cos(t)) for t in times]
    q = [amplitude * 0.5 * math.sin(t) for t in times]
    assert spells(theta, q, h) == (3 if over >= 0.0 else 0)


@pytest.mark.parametrize(
    ("theta", "expected"), [(1.39, False), (1.40, True), (math.pi, True), (-1.5, True), (6.2, False)]
)
def test_upside_down_is_beyond_and_whole_turns_are_not(theta: float, expected: bool) -> None:
    assert tumbles(False, LIMIT_RAD, (theta, 0.0), (theta, 0.0), 0.01) is expected


def test_a_whole_turn_within_a_tick_is_a_tumble() -> None:
    assert tumbles(False, LIMIT_RAD, (0.2, 600.0), (0.2 + math.tau, 600.0), 0.01)


def test_a_vehicle_that_sways_about_the_limit_tumbles_once() -> None:
    near = [LIMIT_RAD + 0.9 * HYSTERESIS_RAD * math.sin(0.3 * k) for k in range(200)]
    assert spells(near, [0.0] * 200, 0.01) == 1
    wide = [LIMIT_RAD + 1.1 * HYSTERESIS_RAD * math.sin(0.3 * k) for k in range(200)]
    assert spells(wide, [0.0] * 200, 0.01) > 5


def test_the_world_tells_begin_and_end_and_thinned_frames_lose_none() -> None:
    config = world_config()
    # It stands beyond the limit at the start, and its restoring moment brings it down.
    nose_down = VehicleSetup(1, (0.0, 0.0, 5.0, -1.5, 0.0), NU0, PARAMS, TAU_MAX)
    told: list[list[Tumble]] = []
    for every in (1, 10):
        lockstep = Lockstep(replace(config, ticks=600, vehicles=(nose_down,)), frame_every=every)
        lockstep.state.lives.end(1, 0)
        frames = [out for out in lockstep.grant(600) if isinstance(out, Frame)]
        told.append([tumble for frame in frames for tumble in frame.tumbles])
        assert all(tumble.tick <= frame.tick for frame in frames for tumble in frame.tumbles)
    assert told[0] == told[1]
    assert [(t.vehicle, t.begins) for t in told[0]] == [(1, True), (1, False)]
    assert told[0][0].tick == 0


def run(folder: Path, name: str, *overrides: str, in_process: bool = True) -> Result:
    return execute(load_scenario(name, overrides), Options(folder, in_process=in_process, quiet=True))


KILLED = "faults=[{at: 500 ms, for: 1500 ms, kill: 3}]"


def test_a_tumble_is_in_log_verdict_and_numbers_and_the_agent_takes_over(tmp_path: Path) -> None:
    """What ended a vehicle for ever: it goes on, its next agent commands it, and the verdict names it."""
    results = [run(tmp_path, "paper", CALM, "duration=3 s", KILLED, in_process=flag) for flag in (True, False)]
    alone, fleet = ((r.directory / "run.mcap").read_bytes() for r in results)
    assert alone == fleet
    result = results[0]
    assert result.status is Status.CHECK_FAILED
    verdict = next(v for v in result.checks if v.check == "tumbled")
    assert not verdict.passed
    assert "vehicle 3" in verdict.found
    assert all(v.passed for v in result.checks if v.check != "tumbled")
    log = open_log(result.directory)
    spell = next(f for f in log.events if f.id == "tumbled-3")
    assert spell.what == "tumbled 3"
    assert result.values["tumbles"][0]["vehicle"] == 3
    assert result.values["tumbles"][0]["from_s"] == spell.begin
    state, command = log["uuv/3/state"], log["uuv/3/command"]
    after = state.t > 2.1
    assert (abs(state.x[after][1:] - state.x[after][:-1]) > 0).all()  # it moves on
    assert (abs(command.tau[command.t > 2.1]) > 0).any()  # and is commanded


def test_tumbles_can_be_waived_limited_and_asked_of_some(tmp_path: Path) -> None:
    tumbling = ["duration=3 s", KILLED, "log.every=10 ticks"]
    for check, status in (
        ("tumbled: waived", Status.PASS),
        ("tumbled: {at_most: 9}", Status.PASS),
        ("tumbled: {vehicles: 1-2}", Status.PASS),
        ("tumbled: {vehicles: 3}", Status.CHECK_FAILED),
    ):
        result = run(tmp_path, "paper", f"checks={{ledger: balanced, {check}}}", *tumbling)
        assert result.status is status, (check, result.checks)
    wide = run(tmp_path, "paper", CALM, *tumbling, "vehicle.tumble_pitch=10 deg")
    assert len(wide.values["tumbles"]) > len(result.values["tumbles"])


def test_a_run_that_goes_on_while_a_vehicle_is_tumbled_knows_it(tmp_path: Path) -> None:
    long = ["duration=4 s", "faults=[{at: 500 ms, kill: 3}]", CALM]
    whole = run(tmp_path, "paper", *long)
    spell = whole.values["tumbles"][0]
    at_ns = round((spell["from_s"] + 0.6) * 1e9)
    assert spell["to_s"] is None or spell["to_s"] * 1e9 > at_ns
    scenario, start = continuation(whole.directory, at_ns)
    rest = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start))
    assert [s["vehicle"] for s in rest.values["tumbles"]][:1] == [3]
    assert rest.values["tumbles"][0]["to_s"] == spell["to_s"]
    assert not next(v for v in rest.checks if v.check == "tumbled").passed


def test_a_run_that_is_meant_to_fail(tmp_path: Path) -> None:
    """`expect: fail` turns the exit status round; what our own processes do must pass all the same."""
    short = ["duration=1 s", "log.every=10 ticks", "expect=fail"]
    broken = run(tmp_path, "paper", "checks={formation_error: {below: 1 mm}, ledger: balanced}", *short)
    assert broken.status is Status.PASS
    assert [(v.check, v.passed) for v in broken.checks if not v.passed or v.check == "expect"] == [
        ("formation_error", False), ("expect", True),
    ]  # fmt: skip
    held = run(tmp_path, "paper", "checks={formation_error: {below: 1 km}}", *short)
    assert held.status is Status.CHECK_FAILED
    assert next(v.found for v in held.checks if v.check == "expect") == "every check passed"
    assert "expect: fail" in load_scenario("paper", ["expect=fail"]).to_yaml()
    assert "expect" not in load_scenario("paper").to_yaml()


def test_one_wreck_hides_nobody(tmp_path: Path) -> None:
    """The error of a fleet is said as maximum, whose it is, and the median vehicle's."""
    result = run(tmp_path, "paper", "checks={formation_error: {below: 1 km}}", "duration=3 s", KILLED)
    spread = result.values["formation"]
    off = {i: row["formation_final_m"] for i, row in result.values["vehicles"].items()}
    assert spread["worst_m"] == max(off.values()) == off[str(spread["vehicle"])]
    assert spread["median_m"] == pytest.approx(sum(sorted(off.values())[1:3]) / 2)
    assert ", the median vehicle " in next(v.found for v in result.checks if v.check == "formation_error")
