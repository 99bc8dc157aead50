"""Runs with a vehicle that is an FMU: alone and distributed, resumed, failing, and of a stranger."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path

import pytest
from fmu_units import VARIABLES, build, description
from in_process_runs import recorded
from marks import slow
from repository import ROOT
from small_scenario import SMALL
from tool import invoke

from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.explanation.no_return import without_faults_after
from fleet.addons.studies.modules import folder_of, modules_of, packed
from fleet.addons.studies.one_run import Task, make_run
from fleet.addons.studies.row import Row
from fleet.addons.studies.shrink import tree_of
from fleet.logs.open_log import open_log
from fleet.mcap.reader import digest
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario

PLANTS = """\
vehicle: {plant: {name: "fmu:two.fmu", parameters: {signals: {effort: effort}}}}
per_vehicle: {2: {vehicle: {plant: "fmu:three.fmu"}}}
"""


def with_units(folder: Path) -> Path:
    """The folder, with a scenario and its units."""
    build(folder / "two.fmu", 2)
    build(folder / "three.fmu", 3)
    (folder / "units.yaml").write_text(SMALL + PLANTS, "utf-8")
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder, in which a scenario and its units lie."""
    monkeypatch.chdir(tmp_path)
    return with_units(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A run in this process, in a folder of its own."""
    folder = with_units(tmp_path_factory.mktemp("units"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return recorded(folder / "runs", "units.yaml")


@pytest.fixture
def there(whole: Result, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of that run, whose units lie in the folder where we are."""
    monkeypatch.chdir(whole.directory.parent.parent)
    return whole.directory


def call(*arguments: str) -> tuple[int, str]:
    """The exit status of a command, and what it says on one line."""
    result = invoke(*arguments)
    return result.exit_code, " ".join(result.output.split())


run = partial(recorded, Path("runs"), "units.yaml")


def test_a_fleet_of_units_gives_the_same_bytes_alone_and_distributed(whole: Result, there: Path) -> None:
    distributed = run(in_process=False)
    assert (whole.status, distributed.status) == (Status.PASS, Status.PASS)
    assert digest(there / "run.mcap") == digest(distributed.directory / "run.mcap")
    log = open_log(there)
    effort = log["uuv/1/plant"].effort
    assert effort[-1] > effort[0] == 0.0
    assert "uuv/2/plant" not in log.topics
    assert log["uuv/2/state"].x[-1] > log["uuv/2/state"].x[0]


@pytest.mark.slow
def test_units_that_report_nothing_are_recorded(folder: Path) -> None:
    log = open_log(run('vehicle={plant: "fmu:two.fmu"}', "per_vehicle={}").directory)
    assert not [topic for topic in log.topics if topic.endswith("/plant")]
    assert log["uuv/3/state"].phi[-1] == 0.0


def test_a_run_goes_on_from_its_log_bit_for_bit(there: Path) -> None:
    status, said = call("run", "--from", f"{there}@0.5s", "--in-process", "--out", "rest", "--trust")
    assert status == 0, said
    [rest] = (path for path in Path("rest").iterdir() if not path.is_symlink())
    one, other = open_log(there), open_log(rest)
    assert one["uuv/1/plant"].effort[-1] == other["uuv/1/plant"].effort[-1] > 0.0
    assert one["uuv/2/state"].u[-1] == other["uuv/2/state"].u[-1]


@pytest.mark.slow
def test_a_run_whose_unit_cannot_save_its_state_goes_on(folder: Path) -> None:
    build(folder / "two.fmu", 2, description(2, saves=False))
    whole = run("per_vehicle={}")
    status, said = call("run", "--from", f"{whole.directory}@0.5s", "--in-process", "--trust", "--out", "rest")
    assert status == 0, said
    one, other = open_log(whole.directory), open_log(Path("rest/latest"))
    assert one["uuv/2/state"].x[-1] == other["uuv/2/state"].x[-1]
    assert call("verify", "rest/latest", "--trust")[0] == 0


def test_a_run_with_units_is_healed_without_copies(folder: Path) -> None:
    """A copy of the process would share the process of the unit."""
    scenario = load_scenario(folder / "units.yaml", ["faults=[{at: 200 ms, mute: 1}]"])
    tree = tree_of(scenario)
    each = tuple((tick, json.dumps(without_faults_after(tree, tick * scenario.tick_ns))) for tick in (30, 60))
    asked = Task(
        "units", 0, scenario.seed, scenario.name, scenario.to_yaml(), 60.0, modules_of([scenario], folder), healed=each
    )
    rows: list[Row] = []
    with local_engine(1) as engine:
        engine.make(iter([asked]), rows.extend, lambda: None)
    alone = [make_run(asked._replace(text=text, healed=())) for _, text in each]
    assert [one.checks for one in rows[0].futures] == [one.checks for one in alone]


def test_a_unit_that_hangs_ends_its_vehicle_and_nothing_else(folder: Path) -> None:
    plant = 'vehicle={plant: {name: "fmu:two.fmu", parameters: {start: {hang_at: 0.5}}, budget: 300 ms}}'
    status, said = call("run", "units.yaml", "--set", plant, "--out", "runs")
    assert status != 0
    assert "tick 50" in said
    assert "vehicle 1: error: two.fmu took longer than its budget of 300 ms" in said
    log = open_log(Path("runs/latest"))
    assert log["uuv/2/state"].t[-1] == pytest.approx(1.0)
    assert log["uuv/2/state"].x[-1] > log["uuv/2/state"].x[len(log["uuv/2/state"].x) // 2]


@pytest.mark.slow
def test_a_run_goes_on_from_a_moment_after_a_unit_crashed(folder: Path) -> None:
    plant = 'vehicle={plant: {name: "fmu:two.fmu", parameters: {start: {crash_at: 0.5}}}}'
    _, said = call("run", "units.yaml", "--set", plant, "--in-process", "--out", "runs")
    assert "tick 50) vehicle 1: error: two.fmu ended its process by signal 6" in said
    log = open_log(Path("runs/latest"))
    assert log["uuv/2/state"].t[-1] == pytest.approx(1.0)
    status, said = call("run", "--from", "runs/latest@0.8s", "--trust", "--in-process", "--out", "again")
    assert status == 1, said  # the check `deaths`, as before
    again = open_log(Path("again/latest"))
    assert again["uuv/2/state"].t[0] == pytest.approx(0.8)
    assert again["uuv/1/state"].x[-1] == log["uuv/1/state"].x[-1]
    assert again["uuv/2/state"].x[-1] == log["uuv/2/state"].x[-1]


@pytest.mark.parametrize("command", ["check", *slow("run")])
def test_a_strangers_unit_does_not_run_unasked(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    out = ["--in-process", "--out", "runs"] if command == "run" else []
    status, said = call(command, "../units.yaml", *out)
    assert "would run" in said
    assert "two.fmu, which is not installed, and the scenario that names it lies outside" in said
    assert "--trust runs it" in said
    if command == "run":
        assert status == 2
        assert not Path("runs").exists()
        assert call(command, "../units.yaml", *out, "--trust")[0] == 0


def test_a_stranger_s_log_runs_no_unit_unasked(there: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call("verify", str(there))[0] == 0
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))  # of somebody else
    status, said = call("verify", str(there))
    assert status != 0
    assert "two.fmu, which is not installed, and a log names it" in said
    assert call("verify", str(there), "--trust")[0] == 0


def test_a_unit_that_is_not_there_is_named_with_its_line(folder: Path) -> None:
    status, said = call("check", "units.yaml", "--set", "vehicle.plant=fmu:four.fmu")
    assert status == 2
    assert "there is no file four.fmu" in said
    assert "it must lie beside the scenario or where you are" in said


def test_units_travel_to_workers_of_other_machines(folder: Path) -> None:
    modules = packed(modules_of([load_scenario("units.yaml")], folder))
    assert modules.units == ("two.fmu", "three.fmu")
    assert [path for path, _ in modules.carried] == ["three.fmu", "two.fmu"]
    there = folder_of(modules)
    assert there is not None
    assert (there / "two.fmu").read_bytes() == (folder / "two.fmu").read_bytes()
    assert set(modules.fingerprints) == {
        hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in ("two.fmu", "three.fmu")
    }


def test_the_scenario_of_the_guide_runs(folder: Path) -> None:
    """Its unit has other names, and a signal."""
    names = {"surge_force": "thrust", "theta": "attitude.pitch", "effort": "propeller.n"}
    names |= {f"{axis}_start": f"{axis}0" for axis in "xyz"}
    text = description(3, [(names.get(name, name), unit, causality) for name, unit, causality in VARIABLES])
    build(folder / "auv.fmu", 3, text)
    page = (ROOT / "docs/guide/fmu.md").read_text("utf-8")
    (folder / "units.yaml").write_text(SMALL + page.partition("```yaml\n")[2].partition("```")[0], "utf-8")
    log = open_log(run().directory)
    assert log["uuv/3/plant"].rpm[-1] > 0.0
