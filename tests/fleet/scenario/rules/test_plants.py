"""Plants in a scenario: who has which, what is wrong with one, and that nobody's runs unasked."""

from __future__ import annotations

from pathlib import Path
from random import getrandbits

import pytest
from one_child import in_one_child
from small_scenario import SMALL, read_back, small

from fleet.addons.studies.modules import modules_of
from fleet.scenario.scenario import Scenario
from world.config import PlantSetup

ROLLING = "vehicle.plant=own_plants:Rolling"
STATES = "initial=[{position: 0 0 5 m, roll: 10 deg, roll_rate: 1 rad/s}, {position: 0 5 5 m}, {position: 0 9 5 m}]"


def plants(scenario: Scenario) -> list[PlantSetup | None]:
    return [setup.plant for setup in scenario.world_config.vehicles]


def test_a_plant_is_per_vehicle_and_its_model_goes_with_it() -> None:
    scenario = small(
        ROLLING,
        "vehicle.surge_force=7 N",
        "per_vehicle={'2': {vehicle: {model: paper}}, "
        "'3': {vehicle: {plant: {name: 'own_plants:Weak', parameters: {lag: 0.1}, budget: 50 ms}}}}",
    )
    rolling, none, weak = plants(scenario)
    assert rolling == PlantSetup("own_plants:Rolling", {}, 10.0)
    assert none is None
    assert weak == PlantSetup("own_plants:Weak", {"lag": 0.1}, 0.05)
    assert [control.tau_max[0] for control in scenario.controls] == [7.0, 20.0, 20.0]
    again = read_back(scenario)
    assert plants(again) == plants(scenario)
    assert "model: paper" in scenario.to_yaml()  # so that whoever reads a log need not import the plant


def test_a_shipped_plant_brings_its_model() -> None:
    scenario = small("vehicle.plant=remus100")
    assert scenario.spec.vehicle.model == "remus100"
    assert scenario.controls == small("vehicle={plant: remus100, model: remus100}").controls


def test_without_a_plant_all_is_as_it_was() -> None:
    scenario = small()
    assert plants(scenario) == [None] * 3
    assert "plant" not in scenario.log_every
    assert "plant" not in scenario.to_yaml()
    assert small(ROLLING).log_every["plant"] == 1


def test_roll_at_the_start() -> None:
    setup = plants(small(ROLLING, STATES))[0]
    assert (setup.phi0, setup.p0) == (pytest.approx(0.17453292519943295), 1.0)


PLANT = """\
import pathlib
pathlib.Path(__file__).with_suffix(".mark").touch()
from own_plants import Rolling
"""


SUPPORT = Path(__file__).parents[3] / "support"  # the test's plants are on no path but that of Python


def test_a_stranger_s_plant_does_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    name = f"hull_{getrandbits(40):x}"
    (there / f"{name}.py").write_text(PLANT)
    (there / "s.yaml").write_text(f"{SMALL}vehicle: {{plant: '{name}:Rolling'}}\n")
    mark = there / f"{name}.mark"
    (ran,) = in_one_child([(there, ["run", "s.yaml", "--in-process", "-q"])], SUPPORT)
    assert ran.status == 0, ran.stderr
    assert mark.exists()
    mark.unlink()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "of somebody else"))
    log = str(next((there / "runs").glob("s-1-*")) / "run.mcap")
    (here / f"{name}.py").write_text(PLANT)
    reading = ["info", log], ["export", log, "--scenario"], ["export", log, "--csv", "tables"]
    running = ["run", "../there/s.yaml", "--in-process", "-q"], ["verify", log]
    refused, verified, *read = in_one_child([(here, arguments) for arguments in (*running, *reading)], SUPPORT)
    assert (refused.status, verified.status) == (2, 2)
    assert f"vehicle.plant: {name}:Rolling: would run" in refused.stderr and "would run" in verified.stderr
    assert [done.status for done in read] == [0, 0, 0], read
    assert not mark.exists() and not (here / f"{name}.mark").exists()
    (trusted,) = in_one_child([(here, ["verify", log, "--trust"])], SUPPORT)
    assert trusted.status == 0, trusted.stderr
    assert (here / f"{name}.mark").exists()


def test_a_plant_travels_to_the_workers_of_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"hull_{getrandbits(40):x}"
    (tmp_path / f"{name}.py").write_text("from own_plants import Rolling\n")
    monkeypatch.chdir(tmp_path)
    modules = modules_of([small(f"vehicle.plant={name}:Rolling")], None)
    assert modules.names == (name,)
    assert modules.files == (str(tmp_path / f"{name}.py"),)


def test_a_signal_of_a_plant_beside_the_scenario_is_known_to_its_checks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"hull_{getrandbits(40):x}"
    (tmp_path / f"{name}.py").write_text(PLANT)
    text = f"{SMALL}vehicle: {{plant: '{name}:Rolling'}}\nchecks: {{signal: {{topic: plant.rol, above: 1}}}}\n"
    (tmp_path / "s.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    (checked,) = in_one_child([(tmp_path, ["check", "s.yaml"])], SUPPORT)
    assert checked.status == 2, checked.stderr
    assert "checks.signal.topic: there is no signal plant.rol" in checked.stderr
