"""FMUs for tests: a vehicle in C, built here as a unit of FMI 2 or 3, and the same equations in Python."""

from __future__ import annotations

import inspect
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from functools import cache
from math import cos, sin
from pathlib import Path

import pytest

from world.api import Vec3, Water

SOURCE = Path(__file__).with_name("fmu_unit.c")
_INPUTS = [("surge_force", "N"), ("pitch_moment", "N.m"), ("yaw_moment", "N.m")]
_INPUTS += [(f"current_{axis}", "m/s") for axis in "xyz"]
_INPUTS += [("X", "N"), ("Y", "N"), ("Z", "N"), ("K", "N.m"), ("M", "N.m"), ("N", "N.m")]
_OUTPUTS = [("x", "m"), ("y", "m"), ("z", "m"), ("phi", "rad"), ("theta", "rad"), ("psi", "rad")]
_OUTPUTS += [("u", "m/s"), ("v", "m/s"), ("w", "m/s"), ("p", "rad/s"), ("q", "rad/s"), ("r", "rad/s")]
_MORE = [("mass", "kg"), ("fail_at", "s"), ("hang_at", "s"), ("crash_at", "s"), ("end_at", "s")]
VARIABLES = [
    *((name, unit, "input") for name, unit in _INPUTS),
    *((name, unit, "output") for name, unit in _OUTPUTS),
    *((f"{name}_start", unit, "parameter") for name, unit in _OUTPUTS),
    *((name, unit, "parameter") for name, unit in _MORE),
    ("effort", "N.s", "output"),
]  # as the enumeration in C has them


@cache
def library(version: int) -> bytes:
    """The unit's library; skips the test where it cannot be built."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    unit = {2: FMU2Slave, 3: FMU3Slave}[version]
    names = [name for name, _ in inspect.getmembers(unit) if name.startswith(f"fmi{version}")]
    with tempfile.TemporaryDirectory() as folder:
        # A unit has every function of the standard; those that ours does not need return an error.
        stubs = Path(folder, "stubs.c")
        stubs.write_text("".join(f"__attribute__((weak)) int {name}(void) {{ return 3; }}\n" for name in names))
        built = Path(folder, "unit.so")
        options = ["-std=gnu11", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        command = [compiler, *options, f"-DFMI={version}", str(SOURCE), str(stubs), "-lm", "-o", str(built)]
        subprocess.run(command, check=True, timeout=120)
        return built.read_bytes()


def description(
    version: int,
    variables: Iterable[tuple[str, str, str]] = VARIABLES,
    *,
    saves: bool = True,
    units: Mapping[str, str] | None = None,
    kind: str = "CoSimulation",
    largest: Mapping[str, float] | None = None,
) -> str:
    """The unit's modelDescription.xml.

    Args:
        variables: name, unit and causality of each.
        saves: whether it can save its state.
        units: definitions, name -> attributes of the base unit.
        kind: CoSimulation or ModelExchange.
        largest: the greatest value of a variable by its name.
    """
    able = str(saves).lower()
    rows, defined = [], []
    for reference, (name, unit, causality) in enumerate(variables):
        variability = "fixed" if causality == "parameter" else "continuous"
        start = "" if causality == "output" else ' start="20"' if name == "mass" else ' start="0"'
        top = f' max="{largest[name]}"' if largest and name in largest else ""
        of_unit = f' unit="{unit}"' if unit else ""
        head = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
        if version == 2:
            rows.append(f"<ScalarVariable {head}><Real{of_unit}{top}{start}/></ScalarVariable>")
        else:
            rows.append(f"<Float64 {head}{of_unit}{top}{start}/>")
    outputs = [k for k, (_, _, causality) in enumerate(variables) if causality == "output"]
    names = dict.fromkeys(unit for _, unit, _ in variables if unit)
    for unit in names:
        base = f"<BaseUnit {units[unit]}/>" if units and unit in units else ""
        defined.append(f'<Unit name="{unit}">{base}</Unit>')
    state = "FMUstate" if version == 2 else "FMUState"
    abilities = (
        f'canGetAndSet{state}="{able}" canSerialize{state}="{able}" canHandleVariableCommunicationStepSize="true"'
    )
    if kind == "ModelExchange":
        abilities = ""
    of_kind = f'<{kind} modelIdentifier="vehicle" {abilities}/>'
    defined_units = f"<UnitDefinitions>{''.join(defined)}</UnitDefinitions>" if defined else ""
    if version == 2:
        head = 'fmiVersion="2.0" modelName="vehicle" guid="{a-vehicle}"'
        events = ' numberOfEventIndicators="0"' if kind == "ModelExchange" else ""
        unknowns = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
        first = f"<InitialUnknowns>{unknowns}</InitialUnknowns>" if outputs else ""
        structure = f"<Outputs>{unknowns}</Outputs>{first}"
        head += events
    else:
        head = 'fmiVersion="3.0" modelName="vehicle" instantiationToken="{a-vehicle}"'
        rows.append('<Float64 name="time" valueReference="1000" causality="independent" variability="continuous"/>')
        structure = "".join(f'<Output valueReference="{k}"/>' for k in outputs)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {head}>{of_kind}{defined_units}'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


def build(path: Path, version: int, text: str | None = None, *, platform: str = "") -> Path:
    """An FMU at a path; with another description, or with its library where another platform has it."""
    folder = platform or {2: "linux64", 3: "x86_64-linux"}[version]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text or description(version))
        archive.writestr(f"binaries/{folder}/vehicle.so", library(version))
    return path


class Reference:
    """The equations of fmu_unit.c."""

    def __init__(self, mass: float = 20.0) -> None:
        self.mass = mass
        self.pose = [0.0] * 6
        self.velocity = [0.0] * 6

    def step(self, tau: Vec3, water: Water, h: float) -> None:
        """One step of the unit."""
        p, nu = self.pose, self.velocity
        sth, cth, sps, cps = sin(p[4]), cos(p[4]), sin(p[5]), cos(p[5])
        along = cth * cps * water.current[0] + cth * sps * water.current[1] - sth * water.current[2]
        nu[0] += h * (tau[0] + water.wrench[0] - 10.0 * (nu[0] - along)) / self.mass
        nu[4] += h * (tau[1] + water.wrench[4] - 5.0 * nu[4] - 3.0 * sth) / 4.0
        nu[5] += h * (tau[2] + water.wrench[5] - 5.0 * nu[5]) / 4.0
        p[0] += h * cth * cps * nu[0]
        p[1] += h * cth * sps * nu[0]
        p[2] -= h * sth * nu[0]
        p[4] += h * nu[4]
        p[5] += h * nu[5] / cth
