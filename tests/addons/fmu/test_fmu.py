"""A vehicle that is an FMU, against the same equations in Python; and units that fail, lie, crash or never return."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from fmu_units import VARIABLES, Reference, build, description
from refusals import check_refusals
from repository import ROOT
from waiting import wait_for

from fleet.addons.fmu import fmu
from fleet.addons.fmu.fmu import FmuPlant, fmu_class
from fleet.addons.fmu.fmu_description import Description, UnitVariable
from fleet.addons.fmu.fmu_variables import _Reader
from world.api import PlantConfig, Vec3, Vec6, Water
from world.config import PlantSetup
from world.errors import FmuError, PlantError, PluginError, UntrustedError
from world.plants.classes import plant_class
from world.plants.fenced_plant import FencedPlant
from world.vehicle_params import VehicleParams

CONFIG = PlantConfig(2, 0.01, 1, VehicleParams(*[1.0] * 14))
REST: Vec6 = (0.0,) * 6
CALM = Water((0.0, 0.0, 0.0), REST)
SEA = Water((0.1, 0.2, -0.05), (1.0, 0.0, 0.0, 0.0, 0.1, -0.1))
TAU: Vec3 = (10.0, 0.2, 0.3)
H = 0.005


@contextmanager
def unit(path: Path, **parameters: Any) -> Iterator[FmuPlant]:
    with closing(fmu_class(path, parameters)(CONFIG)) as plant:
        yield plant


@contextmanager
def fenced(path: Path, budget_s: float = 30.0, **parameters: Any) -> Iterator[FencedPlant]:
    """The unit as the world has it, in the water."""
    with closing(FencedPlant(PlantSetup(f"fmu:{path}", parameters, budget_s, file=str(path)), CONFIG)) as plant:
        plant.start(0, REST, REST)
        yield plant


def advance(plant: FencedPlant, ticks: int) -> None:
    for tick in range(ticks):
        plant.advance(tick, TAU, CALM.current, [CALM.wrench] * 2, H)


@pytest.mark.parametrize("version", [2, 3])
def test_it_moves_as_its_equations_say(version: int, tmp_path: Path) -> None:
    reference = Reference(mass=25.0)
    parameters = {"start": {"mass": 25.0}, "signals": {"effort": "effort"}}
    with unit(build(tmp_path / "auv.fmu", version), **parameters) as plant:
        state = plant.start(REST, REST)
        for _ in range(100):
            state = plant.step(state, TAU, SEA, H)
            reference.step(TAU, SEA, H)
        assert plant.pose(state) == tuple(reference.pose)
        assert plant.velocity(state) == tuple(reference.velocity)
        assert plant.report(state) == {"effort": pytest.approx(100 * H * TAU[0])}
        assert [(s.name, s.unit) for s in plant.signals] == [("effort", "N.s")]


@pytest.mark.parametrize("version", [2, 3])
def test_it_begins_where_the_scenario_says_and_again_after_a_while(version: int, tmp_path: Path) -> None:
    pose, velocity = (1.0, 2.0, 3.0, 0.0, 0.1, -4.0), (0.5, 0.0, 0.0, 0.0, 0.01, 0.02)
    with unit(build(tmp_path / "auv.fmu", version)) as plant:
        first = plant.start(pose, velocity)
        assert (plant.pose(first), plant.velocity(first)) == (pose, velocity)
        moved = plant.step(first, TAU, CALM, H)
        assert plant.start(pose, velocity) == first
        assert plant.step(first, TAU, CALM, H) == moved


def renamed(**names: tuple[str, str]) -> list[tuple[str, str, str]]:
    """The unit's variables, some with another name and unit."""
    return [(*names.get(name, (name, of)), causality) for name, of, causality in VARIABLES]


@pytest.mark.parametrize("version", [2, 3])
def test_names_are_mapped_and_units_converted(version: int, tmp_path: Path) -> None:
    """By the definition of a unit where there is one, by its name otherwise."""
    variables = renamed(surge_force=("thrust", "kgf"), theta=("pitch", "deg"), theta_start=("pitch0", "deg"))
    text = description(version, variables, units={"kgf": 'kg="1" m="1" s="-2" factor="9.80665"'})
    path = build(tmp_path / "auv.fmu", version, text)
    with unit(path, inputs={"surge_force": "thrust"}, outputs={"theta": "pitch"}, initial={"theta": "pitch0"}) as plant:
        state = plant.start((0.0, 0.0, 0.0, 0.0, 0.1, 0.0), REST)
        assert plant.pose(state)[4] == pytest.approx(0.1)
        u = plant.velocity(plant.step(state, (9.80665, 0.0, 0.0), CALM, H))[0]
        assert u == pytest.approx(H * 1.0 / 20.0)  # 1 kgf is the number 1 for the unit


def test_the_greatest_command_is_what_the_unit_says_it_takes(tmp_path: Path) -> None:
    text = description(2, largest={"surge_force": 35.0, "yaw_moment": 4.0})
    with unit(build(tmp_path / "auv.fmu", 2, text)) as plant:
        assert plant.limits == (35.0, fmu._NO_LIMIT, 4.0)


def without(*names: str) -> list[tuple[str, str, str]]:
    # At the same places: the library knows variables by their number.
    return [(f"no_{name}" if name in names else name, of, causality) for name, of, causality in VARIABLES]


def test_a_unit_without_roll_has_none(tmp_path: Path) -> None:
    path = build(tmp_path / "auv.fmu", 2, description(2, without("phi", "p", "phi_start", "p_start")))
    with unit(path) as plant:
        state = plant.step(plant.start(REST, REST), TAU, CALM, H)
        assert (plant.pose(state)[3], plant.velocity(state)[3]) == (0.0, 0.0)
        with pytest.raises(FmuError, match=r"begins with phi = 0 rad, the scenario with 0.1 rad; the unit has no roll"):
            plant.start((0.0, 0.0, 0.0, 0.1, 0.0, 0.0), REST)


def test_water_that_a_unit_does_not_take_is_an_error_unless_the_user_says_so(tmp_path: Path) -> None:
    path = build(tmp_path / "auv.fmu", 2, description(2, without("current_x", "K")))
    with unit(path) as plant:
        state = plant.step(plant.start(REST, REST), TAU, CALM, H)
        with pytest.raises(FmuError, match=r"takes no current_x, and the sea has one; map inputs.current_x, or write"):
            plant.step(state, TAU, SEA, H)
        with pytest.raises(FmuError, match="takes no K, and the sea has one"):
            plant.step(state, TAU, Water((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)), H)
    with unit(path, inputs={"current": "none", "wrench": "none"}) as plant:
        state = plant.start(REST, REST)
        assert plant.step(state, TAU, SEA, H) == plant.step(plant.start(REST, REST), TAU, CALM, H)


def test_a_variable_that_only_has_the_name_of_a_part_of_the_water_is_left_alone(tmp_path: Path) -> None:
    # A mass M, and one K without a unit: to write the disturbance into them would be another vehicle.
    others = {"M": ("M", "kg", "parameter"), "K": ("K", "", "parameter")}
    rows = [others.get(row[0], row) for row in VARIABLES]
    with unit(build(tmp_path / "auv.fmu", 2, description(2, rows))) as plant:
        assert not {"K", "M"} & plant.uses.inputs.keys()
        state = plant.step(plant.start(REST, REST), TAU, CALM, H)
        with pytest.raises(FmuError, match=r"takes no M, and the sea has one; map inputs.M, or write"):
            plant.step(state, TAU, Water((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)), H)
    rows = [("surge_force", "N", "output") if row[0] == "surge_force" else row for row in VARIABLES]
    with pytest.raises(FmuError, match=r"inputs.surge_force: 'surge_force' is of causality output"):
        fmu_class(build(tmp_path / "auv.fmu", 2, description(2, rows)), {})


@pytest.mark.parametrize(("version", "setter"), [(2, "setInteger"), (3, "setInt64")])
def test_an_enumeration_is_set_as_its_version_of_fmi_does(version: int, setter: str) -> None:
    known = Description(version, variables={"mode": UnitVariable("mode", 7, "Enumeration", "parameter")})
    assert list(_Reader(known)._start({"mode": 2})) == [(setter, 7, 2)]


def test_a_start_that_the_unit_does_not_take_says_what_to_map(tmp_path: Path) -> None:
    path = build(tmp_path / "auv.fmu", 2, description(2, without("z_start")))
    expected = r"begins with z = 0 m, the scenario with 5 m; map initial.z to a parameter"
    with unit(path) as plant, pytest.raises(FmuError, match=expected):
        plant.start((0.0, 0.0, 5.0, 0.0, 0.0, 0.0), REST)


def test_wrong_parameters_are_named(tmp_path: Path) -> None:
    path = build(tmp_path / "auv.fmu", 2)
    check_refusals("plants/parameters of a unit", lambda text: fmu_class(path, yaml.safe_load(text)))


def test_a_unit_that_does_not_fit_is_named(tmp_path: Path) -> None:
    cases = [
        (2, {"variables": without("q")}),
        (3, {"variables": without("pitch_moment")}),
        (2, {"kind": "ModelExchange"}),
        (3, {"kind": "ModelExchange"}),
        (2, {"variables": renamed(x=("x", "furlong"))}),
        (3, {"variables": renamed(x=("x", "m")), "units": {"m": 'm="1" offset="2"'}}),
        (2, {"units": {"m": 's="1"'}}),
    ]

    def load(version: int, options: dict[str, Any]) -> None:
        fmu_class(build(tmp_path / "auv.fmu", version, description(version, **options)), {})

    check_refusals("plants/units that do not fit", load, cases, hide={str(tmp_path): "HERE"})


def test_a_unit_of_another_platform(tmp_path: Path) -> None:
    with pytest.raises(
        FmuError, match=r"has no binaries/linux64/vehicle.so, which this machine .* binaries for win64;"
    ):
        fmu_class(build(tmp_path / "auv.fmu", 2, platform="win64"), {})


def test_a_description_that_is_none(tmp_path: Path) -> None:
    cases = [
        '<fmiModelDescription fmiVersion="1.0"/>',
        '<fmiModelDescription fmiVersion="9"/>',
        "<fmiModelDescription",
        '<fmiModelDescription fmiVersion="2.0"/>',
    ]
    check_refusals(
        "plants/no description",
        lambda text: fmu_class(build(tmp_path / "auv.fmu", 2, text), {}),
        cases,
        hide={str(tmp_path): "HERE"},
    )


def test_without_fmpy_a_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = build(tmp_path / "auv.fmu", 2)
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(FmuError, match=r"needs the package FMPy; pip install 'uuv-fleet\[fmu\]'"):
        fmu_class(path, {})


@pytest.mark.parametrize(
    ("version", "start", "words"),
    [
        (2, {"fail_at": 0.05}, r"auv.fmu fmi2DoStep failed with status 3 \(error\): \[ERROR\] the battery is empty$"),
        (3, {"fail_at": 0.05}, r"auv.fmu fmi3DoStep failed with status 3 \(error\)$"),
        (2, {"crash_at": 0.05}, "auv.fmu ended its process by signal 6; the unit crashed, or ended the program$"),
        (3, {"end_at": 0.05}, "auv.fmu asks to end the simulation"),
    ],
)
def test_a_unit_that_fails_names_vehicle_and_tick(
    version: int, start: dict[str, float], words: str, tmp_path: Path
) -> None:
    with fenced(build(tmp_path / "auv.fmu", version), start=start) as plant:
        advance(plant, 5)
        with pytest.raises(PlantError, match=f"^vehicle 2, tick 5: .*{words}"):
            plant.advance(5, TAU, CALM.current, [CALM.wrench] * 2, H)


def test_a_unit_that_never_returns_is_ended(tmp_path: Path) -> None:
    with fenced(build(tmp_path / "auv.fmu", 2), budget_s=0.3, start={"hang_at": 0.0}) as plant:
        with pytest.raises(PlantError, match=r"auv.fmu took longer than its budget of 300 ms"):
            plant.advance(0, TAU, CALM.current, [CALM.wrench], H)
        with pytest.raises(PlantError, match="was ended after it failed"):
            plant.advance(0, TAU, CALM.current, [CALM.wrench], H)


def test_without_a_budget_it_is_ended_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with unit(build(tmp_path / "auv.fmu", 2), start={"hang_at": 0.0}) as plant:
        state = plant.start(REST, REST)
        monkeypatch.setattr(fmu, "_LONGEST_S", 0.2)
        with pytest.raises(FmuError, match=r"did not answer within 0.2 s, and was ended"):
            plant.step(state, TAU, CALM, H)


def unpacked(folder: Path) -> list[Path]:
    return list(folder.glob("uuv-fleet-fmu-*"))


def test_what_was_unpacked_is_private_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with unit(build(tmp_path / "auv.fmu", 2)) as plant:
        [folder] = unpacked(tmp_path)
        assert folder.stat().st_mode & 0o077 == 0
        process = plant._process
        assert process.poll() is None
    assert unpacked(tmp_path) == []
    assert process.poll() is not None


def test_it_ends_with_the_process_that_uses_it_even_while_it_hangs(tmp_path: Path) -> None:
    build(tmp_path / "auv.fmu", 2)
    code = """
import os, sys
from pathlib import Path
from fleet.addons.fmu.fmu import fmu_class
from world.api import Water
plant = fmu_class(Path(sys.argv[1]), {"start": {"hang_at": 0.0}})(None)
plant.start((0.0,) * 6, (0.0,) * 6)
import msgpack
plant._connection.send_bytes(msgpack.packb(["step", [0.0, 0.01, [0.0] * 12]]))  # it hangs now
print(plant._process.pid, flush=True)
os.kill(os.getpid(), 9)
"""
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", code, str(tmp_path / "auv.fmu")]
    done = subprocess.run(command, env=environment, cwd=ROOT, stdout=subprocess.PIPE, timeout=120, check=False)
    assert done.returncode == -9
    number = int(done.stdout)
    wait_for(lambda: not Path(f"/proc/{number}").exists() and not unpacked(tmp_path), 60, "the end of the process")


def test_a_unit_that_nobody_let_in_does_not_run(tmp_path: Path) -> None:
    path = build(tmp_path / "stranger.fmu", 2)
    with pytest.raises(UntrustedError, match="nobody allowed it; --trust runs it"):
        plant_class(f"fmu:{path}", {})


def test_what_is_wrong_with_a_unit_is_an_error_of_plug_ins(tmp_path: Path) -> None:
    path = build(tmp_path / "auv.fmu", 2)
    setup = PlantSetup("fmu:auv.fmu", {"start": {"weight": 1.0}}, 1.0, file=str(path))
    with pytest.raises(PluginError, match=r"plant 'fmu:auv.fmu': start.weight: the unit has no variable 'weight'"):
        FencedPlant(setup, CONFIG)


def test_a_unit_whose_process_is_killed_from_outside_ends_its_vehicle_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with fenced(build(tmp_path / "auv.fmu", 2)) as plant:
        advance(plant, 5)
        unit_of_fmi: FmuPlant = plant._plant
        unit_of_fmi._process.kill()
        with pytest.raises(PlantError, match=r"^vehicle 2, tick 5: .*auv.fmu ended its process by signal 9"):
            plant.advance(5, TAU, CALM.current, [CALM.wrench] * 2, H)
        assert unpacked(tmp_path) == []
