"""The variables of an FMU that are the command, the water, the pose and the velocity, and their units.

The names on our side are those of `world.api`. The scenario gives the unit's names; a name that it leaves out is the
same on both sides. A variable's unit is compared with ours: by the unit definitions of the FMU, or by its name where it
has none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib.util import find_spec
from itertools import islice
from math import isfinite, pi
from pathlib import Path
from platform import machine
from typing import Any

from fleet.addons.fmu.fmu_archive import DESCRIPTION, PLATFORMS, archive, platforms
from fleet.addons.fmu.fmu_description import Description, UnitVariable, parse
from world.errors import FmuError
from world.signal import Signal

# Our names, with the unit of each.
COMMAND = {"surge_force": "N", "pitch_moment": "N m", "yaw_moment": "N m"}
CURRENT = {"current_x": "m/s", "current_y": "m/s", "current_z": "m/s"}
WRENCH = {"X": "N", "Y": "N", "Z": "N", "K": "N m", "M": "N m", "N": "N m"}
POSE = {"x": "m", "y": "m", "z": "m", "phi": "rad", "theta": "rad", "psi": "rad"}
VELOCITY = {"u": "m/s", "v": "m/s", "w": "m/s", "p": "rad/s", "q": "rad/s", "r": "rad/s"}
MOTION = POSE | VELOCITY
WITHOUT_ROLL = frozenset(("phi", "p"))  # a unit with five degrees of freedom has them not; then they are 0
NONE = "none"  # in place of a name: the unit has no such variable, and the user knows

# Exponents of kg, m and s. An angle is a number, with rad or without.
_EXPONENTS = {
    "N": (1, 1, -2),
    "N m": (1, 2, -2),
    "m": (0, 1, 0),
    "m/s": (0, 1, -1),
    "rad": (0, 0, 0),
    "rad/s": (0, 0, -1),
}
# What units are called where the FMU does not define them: ours, and the factor.
_CALLED = {
    **dict.fromkeys(("N m", "N.m", "N*m", "Nm"), ("N m", 1.0)),
    **dict.fromkeys(("m/s", "m.s-1"), ("m/s", 1.0)),
    **dict.fromkeys(("rad/s", "rad.s-1"), ("rad/s", 1.0)),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "m": ("m", 1.0),
    "rad": ("rad", 1.0),
    "deg": ("rad", pi / 180.0),
    "deg/s": ("rad/s", pi / 180.0),
}
_FLOATS = ("Real", "Float64")
_COMPARED = 10_000  # variables with which a name that is not there is compared


@dataclass(frozen=True, slots=True)
class Variable:
    reference: int
    factor: float = 1.0  # times its value: ours, in SI
    largest: float | None = None  # that it takes, in SI; None: not said


@dataclass(frozen=True, slots=True)
class Variables:
    """The variables that a scenario uses of a unit. Variables that the unit lacks are missing in the mappings."""

    inputs: dict[str, Variable]
    outputs: dict[str, Variable]
    initial: dict[str, Variable]
    ignored: frozenset[str]  # inputs that the user says are none
    signals: tuple[tuple[Signal, Variable], ...]
    start: tuple[tuple[str, int, Any], ...]  # (type, reference, value)


def describe(path: Path) -> Description:
    """Read the model description of an FMU, and the facts that are needed to start it. No code of the FMU runs. Raises
    FmuError: the file cannot be read, is no FMU for co-simulation, or has no binary for this machine; or the package
    FMPy is not installed."""
    try:
        status = path.stat()
    except OSError as error:
        raise FmuError(f"cannot be read: {error.strerror}") from None
    return _describe(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _describe(path: Path, changed: int, size: int) -> Description:
    if find_spec("fmpy") is None:
        raise FmuError("needs the package FMPy", "pip install 'uuv-fleet[fmu]'")
    with archive(path) as opened:
        there, names = platforms(opened), set(opened.namelist())
        model = parse(opened.read(DESCRIPTION))
    if model.model is None:
        raise FmuError("is not for co-simulation: it has no solver of its own", "export it for co-simulation")
    here, folder = _platform(model.version)
    library = f"binaries/{folder}/{model.model}{_SUFFIX.get(sys.platform, '.so')}"
    if library not in names:
        listed = f"it has binaries for {', '.join(there)[:500]}" if there else "it has no binaries"
        raise FmuError(
            f"has no {library[:200]}, which this machine ({here}) needs; {listed}", "build it for this platform"
        )
    model.library = library
    return model


_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}


def _platform(version: int) -> tuple[str, str]:
    system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
    processor = {"amd64": "x86_64", "arm64": "aarch64", "i686": "x86", "i386": "x86"}.get(
        machine().lower(), machine().lower()
    )
    here = f"{processor}-{system}"
    return here, here if version == 3 else PLATFORMS.get(here, here)


def variables(
    model: Description,
    inputs: Any = None,
    outputs: Any = None,
    initial: Any = None,
    start: Any = None,
    signals: Any = None,
) -> Variables:
    """The variables that a scenario's parameters name: `inputs` (a command, or of the water), `outputs` and `initial`
    (pose and velocity) by our names, `start` with its value, `signals` by the name in the log. Raises FmuError: the
    unit has no such variable, or it has the wrong causality, type or unit."""
    return _Reader(model).variables(inputs, outputs, initial, start, signals)


class _Reader:
    def __init__(self, model: Description) -> None:
        self._known = model.variables
        self._setters = _SETTERS | (_OF_FMI_3 if model.version == 3 else {})
        self._units = model.units

    def variables(self, inputs: Any, outputs: Any, initial: Any, start: Any, signals: Any) -> Variables:
        chosen = _names("inputs", inputs, COMMAND | CURRENT | WRENCH)
        namesakes = {  # what only has the name of a part of the water by chance, such as a mass M
            key: NONE for key in CURRENT | WRENCH if key in self._known and self._known[key].causality != "input"
        }
        taken = self._group("inputs", COMMAND | CURRENT | WRENCH, namesakes | chosen, frozenset(COMMAND))
        for key in taken:
            name = chosen.get(key, key)
            if self._known[name].causality not in ("input", "parameter"):
                hint = "it must be an input, or a tunable parameter"
                raise FmuError(f"inputs.{key}: {name!r} is of causality {self._known[name].causality}", hint)
        named = _names("outputs", outputs, MOTION)
        read = self._group("outputs", MOTION, named, frozenset(MOTION) - WITHOUT_ROLL)
        begins = {key: f"{key}_start" for key in MOTION if f"{key}_start" in self._known}
        begun = self._group("initial", MOTION, begins | _names("initial", initial, MOTION), frozenset())
        ignored = frozenset(key for key, name in chosen.items() if name == NONE)
        if wrong := sorted(ignored & COMMAND.keys()):
            raise FmuError(f"inputs.{wrong[0]}: a unit without it cannot be commanded")
        return Variables(taken, read, begun, ignored, tuple(self._signals(signals)), tuple(self._start(start)))

    def _group(
        self, group: str, ours: Mapping[str, str], chosen: Mapping[str, str], needed: frozenset[str]
    ) -> dict[str, Variable]:
        found: dict[str, Variable] = {}
        for key, unit in ours.items():
            name = chosen.get(key, "" if group == "initial" else key)
            if name in ("", NONE) or (name not in self._known and key not in chosen and key not in needed):
                continue
            variable = self._variable(f"{group}.{key}", name)
            if variable.type not in _FLOATS or variable.array:
                raise FmuError(f"{group}.{key}: {name!r} is a {variable.type}: expected one number, Real or Float64")
            factor = self._factor(f"{group}.{key}", variable, unit)
            largest = variable.largest * factor if variable.largest is not None else None
            found[key] = Variable(variable.reference, factor, largest)
        return found

    def _variable(self, place: str, name: str) -> UnitVariable:
        if name in self._known:
            return self._known[name]
        close = get_close_matches(name, islice(self._known, _COMPARED), 1)
        some = [v.name[:60] for v in self._known.values() if v.causality in ("input", "output", "parameter")][:8]
        hint = f'did you mean "{close[0]}"?' if close else f"it has {', '.join(some)}, ..." if some else ""
        raise FmuError(f"{place}: the unit has no variable {name!r}", hint)

    def _factor(self, place: str, variable: UnitVariable, ours: str) -> float:
        unit = variable.unit
        if not unit:
            return 1.0
        problem = f"{place}: {variable.name!r} is in {unit!r}: expected {ours}"
        if (base := self._units.get(unit)) is None:
            called, factor = _CALLED.get(unit, ("", 0.0))
            if called != ours:
                raise FmuError(problem)
            return factor
        if base.exponents != _EXPONENTS[ours] or base.others or base.offset:
            raise FmuError(problem)
        if base.factor <= 0.0:
            raise FmuError(f"{place}: unit {unit!r} has the factor {base.factor!r}")
        return base.factor

    def _signals(self, signals: Any) -> Iterable[tuple[Signal, Variable]]:
        for key, name in _texts("signals", signals).items():
            variable = self._variable(f"signals.{key}", name)
            if variable.type not in _FLOATS or variable.array:
                raise FmuError(f"signals.{key}: {name!r} is a {variable.type}: expected one number, Real or Float64")
            yield Signal(key, variable.unit or "1", variable.description or name), Variable(variable.reference)

    def _start(self, start: Any) -> Iterable[tuple[str, int, Any]]:
        if start is not None and not isinstance(start, Mapping):
            raise FmuError(f"start: expected names with values, got {start!r:.80}")
        for name, value in (start or {}).items():
            variable = self._variable(f"start.{name}", str(name))
            kind = variable.type
            right = (
                isinstance(value, bool)
                if kind == "Boolean"
                else isinstance(value, str)
                if kind == "String"
                else isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
            )
            whole = kind.startswith(("Int", "UInt", "Enum"))
            if not right or variable.array or (whole and value != int(value)):
                raise FmuError(f"start.{name}: expected a {kind}, got {value!r:.80}")
            if kind not in self._setters:
                raise FmuError(f"start.{name}: a {kind} cannot be given here", f"known: {', '.join(self._setters)}")
            yield self._setters[kind], variable.reference, int(value) if whole else value


# The setter of fmpy for each type.
_SETTERS = {
    "Real": "setReal",
    "Integer": "setInteger",
    "Enumeration": "setInteger",
    "Float64": "setFloat64",
    "Float32": "setFloat32",
    "Int32": "setInt32",
    "Int64": "setInt64",
    "Boolean": "setBoolean",
    "String": "setString",
}
_OF_FMI_3 = {"Enumeration": "setInt64"}


def _texts(group: str, value: Any) -> dict[str, str]:
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(text, str) for pair in value.items() for text in pair):
        raise FmuError(f"{group}: expected names with the names of the unit's variables, got {value!r:.80}")
    return dict(value)


def _names(group: str, value: Any, ours: Mapping[str, str]) -> dict[str, str]:
    """The names of the unit by ours; `current: none` and `wrench: none` stand for all of them."""
    names = _texts(group, value)
    for several, parts in (("current", CURRENT), ("wrench", WRENCH)):
        if group == "inputs" and several in names:
            if names[several] != NONE:
                raise FmuError(f"{group}.{several}: expected {NONE}, or {', '.join(parts)} one by one")
            del names[several]
            names |= dict.fromkeys(parts, NONE)
    if unknown := [key for key in names if key not in ours]:
        close = get_close_matches(unknown[0], ours, 1)
        hint = f'did you mean "{close[0]}"?' if close else f"known: {', '.join(ours)}"
        raise FmuError(f"{group}: there is no {unknown[0]!r}", hint)
    return names
