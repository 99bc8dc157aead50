"""A sea with every mechanism in it moves as it did: states, and what agents are told, against stored numbers.

Laws of single modules stand in the other tests. This one notices a changed sign or constant anywhere between them.
`WRITE_WORLD=1 pytest tests/world/test_world_golden.py` writes the numbers anew, after a change that is meant.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.mcap.reader import LogReader
from fleet.repeat.resume import continuation
from fleet.scenario.loading import parse_scenario
from fleet.scenario.text.overrides import FAULT, Override

GOLDEN = ROOT / "tests" / "expected" / "world.json"
# Vehicles 3 and 4 have six degrees of freedom, 2 and 4 are out of sight of the bottom, 5 has the error of a trace.
SEA = """\
title: A sea with everything in it
vehicles: 6
duration: 4 s
reference: {start: 0 0 20 m, velocity: 0.7 0.1 0.02 m/s}
formation: {shape: grid, spacing: 8 m}
graph: {shape: ring, reference: all}
initial: {scatter: 1 m, surge: 0.7 m/s, around: reference}
profile: hardened
sea: {disturbance: paper, current: {mean: 0.1 -0.2 0.02 m/s, sigma: 3 4 1 cm/s, time_constant: 3 s}}
network: {period: 100 ms, links: {"*": delay 100ms 20ms loss 10%}}
sensors: {position_noise: 2 cm, angle_noise: 0.2 deg, velocity_noise: 1 cm/s, rate_noise: 0.1 deg/s}
checks: {tumbled: waived}
"""
NAVIGATED = """\
per_vehicle:
  "1": {navigation: {usbl: {at: 0 0 2 m, period: 500 ms, delay: 300 ms, loss: 20 %}}}
  "3": {vehicle: {plant: remus100}, profile: remus100}
  "2, 4": {navigation: {bottom: 900 m}}
  "4": {vehicle: {plant: bluerov2}}
  "5":
    navigation: {trace: "time [s],north [m],east [m],down [m],heading [deg]\\n0,0,0,0,1\\n2,.5,-1,.2,2\\n9,1,1,0,-1"}
navigation: {grade: mems, start: 50 cm, bottom: 60 m}
"""
KNOWN = """\
per_vehicle:
  "3": {vehicle: {plant: remus100}, profile: remus100}
  "4": {vehicle: {plant: bluerov2}}
"""
OF_INSTRUMENTS = [
    "at 300ms for 2s dvl {vehicles: '1-3', lost: 40 %, bias: 3 -2 1 cm/s, jump: 10 cm/s, chance: 50 %}",
    "at 500ms for 1s compass {vehicles: '1,4', bias: 3 deg, jump: 1 deg, chance: 50 %}",
    "at 200ms for 3s fix {vehicles: 1, bias: 1 -1 m, jump: 2 m, chance: 50 %}",
]
OF_SENSORS = [
    "at 400ms for 600ms noise {vehicles: '1-4', position_noise: 10 cm, rate_noise: 1 deg/s}",
    "at 700ms for 500ms bias {vehicles: '2-4', position: 1 0 -1 m, velocity: 10 0 5 cm/s, yaw: 2 deg, roll: 1 deg}",
    "at 900ms for 400ms freeze 3",
    "at 300ms dropout {vehicles: '5-6', probability: 30 %}",
]
OF_ACTUATORS = [
    "at 300ms for 1s efficiency {vehicles: '4', surge: 40 %, pitch: 50 %, yaw: 60 %}",
    "at 1200ms for 500ms stuck 5",
    "at 600ms for 400ms off 2",
    "at 1s for 700ms saturate {vehicles: 3, surge_force: 5 N, yaw_moment: 1 Nm}",
    "at 500ms for 700ms wrench {vehicles: '1,3', force: 20 -10 5 N, yaw_moment: 5 Nm}",
    "at 1500ms for 1500ms wrench {vehicles: 6, pitch_moment: 400 Nm}",
]
OF_SEA_AND_AGENTS = [
    "at 800ms gust {velocity: 0.3 0.1 0.05 m/s, over: 900 ms}",
    "at 1s for 1s current {sigma: 5 5 1 cm/s, time_constant: 2 s}",
    "at 1100ms for 300ms pause 4",
    "at 600ms for 600ms slow {vehicles: 1, by: 5 ticks}",
    "at 1300ms for 400ms kill 2",
    "at 400ms for 2s clock {vehicles: '1-2', step: 30 ms, drift: 900 ppm}",
]
PRINTED = ["tracking.astern=printed"]  # as when the numbers were written
CASES = {
    "estimated": (SEA.replace("sensors", "#") + NAVIGATED, OF_INSTRUMENTS + OF_ACTUATORS + OF_SEA_AND_AGENTS),
    "measured": (SEA + KNOWN, OF_SENSORS + OF_ACTUATORS + OF_SEA_AND_AGENTS),
}


def moved(text: str, faults: list[str]) -> list[list[Any]]:
    """Every quarter of a second, each vehicle: its state, and what its agent was told."""
    found = []
    with fleet.Run(parse_scenario(text, "sea.yaml", PRINTED), fault=faults) as run:
        while not run.over:
            run.step(25)
            for one in run.state.vehicles.values():
                told = one.told
                heard = () if told is None else (*told.eta, *told.nu, *told.roll, *told.belief)
                found.append([one.id, run.state.tick, [*one.eta, *one.nu], list(heard)])
    return found


@pytest.mark.parametrize("name", CASES)
def test_it_moves_as_it_did(name: str) -> None:
    ours = moved(*CASES[name])
    golden: dict[str, Any] = json.loads(GOLDEN.read_text("utf-8")) if GOLDEN.exists() else {}
    if os.environ.get("WRITE_WORLD"):
        golden[name] = json.loads(json.dumps(ours), parse_float=lambda text: float(f"{float(text):.9g}"))
        GOLDEN.write_text(
            json.dumps(golden, separators=(",", ":")).replace("[[", "\n[[").replace("],[", "],\n["), "utf-8"
        )
    assert len(ours) == len(golden[name]) == 6 * 16
    for (i, tick, state, heard), (j, when, its, told) in zip(ours, golden[name], strict=True):
        assert (i, tick) == (j, when)
        assert state == pytest.approx(its, rel=1e-6, abs=1e-7), f"vehicle {i}, tick {tick}"
        assert heard == pytest.approx(told, rel=1e-6, abs=1e-7), f"what vehicle {i} was told at tick {tick}"


@pytest.mark.slow  # the table of the same bytes has runs that go on
@pytest.mark.parametrize("name", ["estimated", "measured"])
def test_it_goes_on_from_a_snapshot(name: str, tmp_path: Path) -> None:
    """All that its vehicles, plants, instruments and filters remember is in a snapshot."""
    text, faults = CASES[name]
    changes = [*(Override(FAULT, fault) for fault in faults)]
    first = execute(parse_scenario(text, "sea.yaml", changes), Options(tmp_path, in_process=True, quiet=True))
    scenario, start = continuation(first.directory, 1_000_000_000)
    again = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start))
    whole, rest = (
        [record for record in LogReader(run.directory / "run.mcap") if record.log_ns >= 1_000_000_000]
        for run in (first, again)
    )
    assert len(rest) > 1000
    assert rest == whole
