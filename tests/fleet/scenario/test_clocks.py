"""Clocks in a scenario: given, drawn, merged and printed; and what a check says of slots."""

from __future__ import annotations

from statistics import mean, stdev

import pytest
from small_scenario import read_back, small

from fleet.analysis.slots import describe_slack, slack
from fleet.execution.whole_run import run
from fleet.scenario.loading import load_scenario
from netem.vehicle_clock import VehicleClock

WATER = "network={period: 1 s, payload: compact, acoustic: {modem: mfsk-1066, mac: tdma, slot: 1500 ms, guard: 200 ms}}"
ELECTION = "fleet.protocols.election:Election"


def test_a_clock_is_of_all_or_of_some_and_reads_back() -> None:
    scenario = small(
        "agent.clock={drift: 20 ppm, offset: 5 ms}",
        "per_vehicle={'2': {agent: {clock: {drift: -15 ppm}}}, '3': {agent: {clock: {offset: {mean: -1 s}}}}}",
    )
    expected = {
        1: VehicleClock(5_000_000, 20e-6), 2: VehicleClock(5_000_000, -15e-6), 3: VehicleClock(-1_000_000_000, 20e-6)
    }  # fmt: skip
    assert scenario.clocks == scenario.world_config.clocks == scenario.netem_config.clocks == expected
    read_back(scenario)
    assert small().clocks == {}


def test_a_clock_leaves_the_laws_alone() -> None:
    """One for some vehicles is no whole agent, and a controller chosen for some keeps their clocks."""
    whole = f"agent={{law: {ELECTION}, parameters: {{vehicles: 3}}, clock: {{offset: 1 s}}}}"
    scenario = small(whole, "per_vehicle={'2': {agent: {clock: {drift: 1 ppm}}}, '3': {controller: bc}}")
    assert [c.agent is not None for c in scenario.controls] == [True, True, False]
    assert {i: clock.offset_ns for i, clock in scenario.clocks.items()} == dict.fromkeys((1, 2, 3), 10**9)
    assert [c.agent for c in small("agent.clock={}").controls] == [None] * 3
    short = small(f"agent={ELECTION}", "agent.parameters.vehicles=3", "agent.clock.offset=1 ms")
    assert short.controls[0].agent is not None and short.clocks[1] == VehicleClock(1_000_000)


def test_drawn_clocks_are_normal_and_each_vehicle_has_its_own() -> None:
    drawn = "agent.clock={drift: {mean: 10 ppm, sigma: 20 ppm}, offset: {sigma: 5 ms}}"
    fleet = load_scenario("paper", ["vehicles=300", drawn]).clocks
    drifts = [clock.drift * 1e6 for clock in fleet.values()]
    offsets = [clock.offset_ns / 1e6 for clock in fleet.values()]
    assert abs(mean(drifts) - 10) < 4 and abs(stdev(drifts) - 20) < 3
    assert abs(mean(offsets)) < 1 and abs(stdev(offsets) - 5) < 0.7
    few, other = (load_scenario("paper", [drawn, f"seed={seed}"]).clocks for seed in (1, 2))
    assert few == {i: fleet[i] for i in (1, 2, 3, 4)} and few != other


def test_what_slots_bear_is_their_guard_less_sound_and_a_tick() -> None:
    scenario = small("duration=4 s", WATER)
    found = slack(scenario)
    # The slot is 1.5 s; the formation is 7.07 m across; a start is up to a tick late.
    airtime_s = scenario.acoustic.modem.airtime_ns(15) / 1e9
    assert found.difference_s == pytest.approx(1.5 - airtime_s - 50**0.5 / 1500 - 0.01, abs=1e-6)
    assert found.drift == pytest.approx(found.difference_s / 8)
    assert "ppm, fast or slow, in a run of 4 s" in next(describe_slack(scenario))
    assert slack(small()) is None and list(describe_slack(small())) == []


def test_only_differences_matter_and_the_log_keeps_the_truth() -> None:
    """A check sees the error of the clock; the vehicles follow the reference by what their clocks show."""
    still = {"duration": "2 s", "initial": {"scatter": "0 m", "surge": "0.5 m/s", "around": "reference"}}
    ahead = "|clock.error|"
    result = run(
        small("agent.clock={offset: 100 ms}"),
        set=still | {"checks": {"signal": {"topic": ahead, "within": ["99.9 ms", "100.1 ms"]}}},
    )
    assert {v.check: v.passed for v in result.checks}["clock.error"]
