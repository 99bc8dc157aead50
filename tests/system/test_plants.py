"""Fleets with plants: as processes, from a log, in a study, and when a plant fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from repository import ROOT
from tool import invoke

from fleet.addons.studies.explanation.what_if import what_if
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.open_log import open_log
from fleet.recorder.start import Start
from fleet.repeat.resume import continuation
from fleet.repeat.verify import verify
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario

MIXED = (
    "per_vehicle={1: {vehicle: {plant: 'own_plants:Rolling'}}, 2: {vehicle: {plant: 'own_plants:Counting'}}, "
    "3: {vehicle: {plant: {name: 'own_plants:Weak', parameters: {lag: 0.03}}}}}"
)
SHORT = ("duration=2 s", "checks={ledger: balanced}", "profile=hardened", MIXED)
NOISY = (*SHORT, "sensors.angle_noise=1 deg", "faults=[{at: 500 ms, for: 300 ms, freeze: 1}]")


def mixed(*overrides: str) -> Scenario:
    return load_scenario("rough-sea", [*NOISY, *overrides])


def run(scenario: Scenario, folder: Path, *, in_process: bool = True, start: Start | None = None) -> Result:
    return execute(scenario, Options(folder, in_process=in_process, quiet=True), wiring=Wiring(start=start))


FAILING = "per_vehicle.2.vehicle={plant: {name: 'own_plants:Failing', parameters: {how: raise, at: 60}}}"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Result:
    result = run(mixed(), tmp_path_factory.mktemp("mixed"))
    assert result.status is Status.PASS, result.reason
    return result


def test_the_log_has_roll_where_there_is_a_plant(recorded: Result) -> None:
    log = open_log(recorded.directory)
    state, nav, plant = log["uuv/1/state"], log["uuv/1/nav"], log["uuv/1/plant"]
    assert state.units["phi"] == "rad" and state.units["p"] == "rad/s"
    assert abs(state.phi).max() > 0.001
    assert (plant.units["thrust"], plant.fins.shape) == ("N", (201, 2))
    assert (nav.phi != state.phi[:-1]).all()  # the sensor has noise
    assert "phi" not in log["uuv/4/state"].units
    assert "uuv/4/plant" not in log
    turn = log["uuv/1/pose"]["pose.orientation"]
    w, x, y, z = turn[:, 3], turn[:, 0], turn[:, 1], turn[:, 2]
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    assert np.allclose(roll, state.phi, atol=1e-12)


def test_processes_give_the_same_bytes(recorded: Result, tmp_path: Path) -> None:
    assert run(mixed(), tmp_path, in_process=False).digest == recorded.digest


def test_a_log_is_verified_and_gone_on_from(recorded: Result, tmp_path: Path) -> None:
    assert verify(recorded.directory).reproduced
    scenario, start = continuation(recorded.directory, 10**9)
    rest = run(scenario, tmp_path, start=start)
    whole, half = open_log(recorded.directory), open_log(rest.directory)
    for topic in ("uuv/1/state", "uuv/2/state", "uuv/3/plant", "uuv/1/nav"):
        for name in whole[topic].units:
            assert (getattr(whole[topic], name)[100:] == getattr(half[topic], name)).all(), (topic, name)


def test_another_vehicle_goes_on_from_a_log(recorded: Result, tmp_path: Path) -> None:
    scenario, start = continuation(recorded.directory, 10**9, ["per_vehicle.2.vehicle={model: paper}"])
    other = open_log(run(scenario, tmp_path, start=start).directory)
    before = open_log(recorded.directory)["uuv/2/state"]
    assert other["uuv/2/state"].x[0] == before.x[100]
    assert other["uuv/2/state"].x[-1] != before.x[-1]


def test_a_recorded_agent_answers_as_it_did(recorded: Result) -> None:
    assert what_if(recorded.directory, 1).identical


def test_a_plant_that_fails_is_left_behind(tmp_path: Path) -> None:
    result = run(mixed(FAILING), tmp_path / "on")
    assert result.status is Status.CHECK_FAILED  # a death that no fault asked for
    (note,) = [note for note in result.values["notes"] if "vehicle 2" in note]
    assert "error: Failing raised ZeroDivisionError: no water (" in note
    assert "vehicle 2 is not integrated any more" in note
    assert len(open_log(result.directory)["uuv/2/state"].x) == 201


@pytest.mark.parametrize("in_process", [True, False], ids=["in one process", "as processes"])
def test_a_plant_that_fails_ends_the_run(in_process: bool, tmp_path: Path) -> None:
    result = run(mixed(FAILING, "on_death=abort"), tmp_path, in_process=in_process)
    assert result.status is Status.BROKEN
    said = "\n".join((result.reason, *result.lines))
    assert "vehicle 2, tick 60: Failing raised ZeroDivisionError: no water (" in said
    assert len(open_log(result.directory)["uuv/2/state"].x) > 50  # all that was recorded is there


def test_a_plant_that_cannot_start_is_told_before_the_run(tmp_path: Path) -> None:
    plant = "per_vehicle.2.vehicle.plant=own_plants:Elsewhere"
    found = invoke("run", "rough-sea", "--out", tmp_path / "runs", "--set", plant)
    assert found.exit_code == 2
    assert "plant own_plants:Elsewhere: vehicle 2, tick 0: Elsewhere has the pose (" in found.stderr
    assert not (tmp_path / "runs").exists()


def test_the_guide_shows_the_example_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    examples = ROOT / "docs" / "examples"
    page = (ROOT / "docs" / "guide" / "your-vehicle.md").read_text("utf-8")
    shown = page.split("```python\n")[1].split("```")[0]
    assert (examples / "torpedo.py").read_text("utf-8").split("\n", 2)[2].strip() == shown.strip()
    monkeypatch.chdir(examples)
    assert invoke("check", "torpedo.yaml").exit_code == 0
    more = ["--in-process", "-q", "--duration", "2 s", "--set", "checks={ledger: balanced}", "--out", tmp_path]
    found = invoke("run", "torpedo.yaml", *more)
    assert found.exit_code == 0, found.output


@pytest.mark.slow
def test_the_example_holds_its_formation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / "docs" / "examples")
    assert invoke("run", "torpedo.yaml", "--in-process", "-q", "--out", tmp_path).exit_code == 0
