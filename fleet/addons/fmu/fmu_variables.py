"""The variables of an FMU that are the command, the water, the pose and the velocity, and their units.

The names on our side are those of `world.api`. The scenario gives the unit's names; a name that it leaves out is the
same on both sides. A variable's unit is compared with ours: by the unit definitions of the FMU, or by its name where it
has none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import lru_cache
from importlib.util import find_spec
from itertools import islice
from math import isfinite, isinf, pi
from pathlib import Path
from platform import machine
from typing import Any
from xml.parsers import expat

from fleet.addons.fmu.fmu_archive import DESCRIPTION, PLATFORMS, archive, platforms
from netem.limits import FMU_DESCRIPTION
from world.errors import FmuError
from world.signal import Signal

# The model description of an FMU: its XML is read in one pass, in a time and a memory that its size bounds.
#
# fmpy's reader is not used. It validates with native code, whose time grows with the square of the mistakes (10 kB with
# 100,000 variables without names took minutes), and which no signal ends.

MAX_VARIABLES = 200_000
_MOST_TEXT = 1000  # characters of a description or a unit that are kept
_OF_FMI_2 = frozenset(("Real", "Integer", "Boolean", "String", "Enumeration"))
_TAGS_OF_FMI_3 = frozenset(
    (
        *("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
        *("Boolean", "String", "Binary", "Enumeration", "Clock"),
    )
)
_TRUE = ("true", "1")


@dataclass(frozen=True, slots=True)
class BaseUnit:
    """A unit of the FMU in SI: exponents, factor and offset."""

    exponents: tuple[int, int, int]  # of kg, m and s
    others: bool  # whether it has A, K, mol or cd
    factor: float
    offset: float


@dataclass(frozen=True, slots=True)
class UnitVariable:
    """A variable as the FMU declares it."""

    name: str
    reference: int
    type: str  # Real, Float64, Integer, ...
    causality: str
    description: str = ""
    unit: str = ""
    largest: float | None = None  # its `max`
    array: bool = False


@dataclass(slots=True)
class Description:
    """The parts of a model description that we use."""

    version: int = 0  # 2 or 3
    guid: str = ""
    model: str | None = None  # the identifier of its model for co-simulation; None: it has none
    library: str = ""  # in the unpacked archive, for this machine
    units: dict[str, BaseUnit] = field(default_factory=dict)
    variables: dict[str, UnitVariable] = field(default_factory=dict)


def parse(data: bytes) -> Description:
    """A model description from its XML. Raises FmuError: it is not of FMI 2 or 3, or it is too large."""
    reader = _Description()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.StartDoctypeDeclHandler = reader.doctype
    try:
        parser.Parse(data, True)  # all at once: a long token in pieces would be looked at again with each
    except expat.ExpatError as error:
        raise FmuError(f"has a {DESCRIPTION} that cannot be read: {str(error)[:200]}") from None
    except (LookupError, UnicodeError) as error:  # an encoding that is none
        raise FmuError(f"has a {DESCRIPTION} that cannot be read: {str(error)[:200]}") from None
    return reader.finish()


class _Description:
    def __init__(self) -> None:
        self._found = Description()
        self._path: list[str] = []
        self._elements = 0
        self._variable: UnitVariable | None = None  # whose element is open
        self._aliases: list[str] = []
        self._named = ""  # the unit or the type whose element is open
        self._declared: dict[str, str] = {}  # the unit of each type that has one
        self._of_type: dict[str, str] = {}  # by name of a variable: the type that it refers to

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        if self._elements > FMU_DESCRIPTION.items:
            raise FmuError(
                f"has a {DESCRIPTION} of more than {FMU_DESCRIPTION.items} elements", "it has too many variables"
            )
        if len(self._path) == FMU_DESCRIPTION.depth:
            raise _not_valid(f"its elements are nested more than {FMU_DESCRIPTION.depth} deep")
        self._path.append(tag)
        match self._path:
            case [_]:
                self._root(tag, attributes)
            case [_, "CoSimulation"]:
                self._simulation(attributes)
            case [_, "UnitDefinitions", "Unit"]:
                self._named = attributes.get("name", "")
            case [_, "TypeDefinitions", "SimpleType"]:
                self._named = attributes.get("name", "")
                self._declared[self._named] = ""  # also those without a unit, such as enumerations
            case [_, "UnitDefinitions", "Unit", "BaseUnit"]:
                self._found.units[self._named] = _base_unit(self._named, attributes)
            case [_, "TypeDefinitions", "SimpleType", "Real"]:
                self._declared[self._named] = attributes.get("unit", "")
            case [_, "TypeDefinitions", _]:
                self._declared[attributes.get("name", "")] = attributes.get("unit", "")
            case [_, "ModelVariables", _]:
                self._begin(tag, attributes)
            case [_, "ModelVariables", "ScalarVariable", kind] if kind in _OF_FMI_2:
                self._typed(kind, attributes)
            case [_, "ModelVariables", _, "Dimension"] if self._variable is not None:
                self._variable = replace(self._variable, array=True)
            case [_, "ModelVariables", _, "Alias"]:
                self._aliases.append(attributes.get("name", ""))

    def end(self, tag: str) -> None:
        if len(self._path) == 3 and self._variable is not None:
            self._take(self._variable)
            self._variable = None
        self._path.pop()

    def doctype(self, *_: object) -> None:
        raise _not_valid("it has a DOCTYPE, which FMI knows not")

    def finish(self) -> Description:
        """All that was read, with the units of the types that variables refer to."""
        found = self._found
        if not found.variables:
            raise _not_valid("it has no variables")
        for name, of in self._of_type.items():
            if of not in self._declared:
                raise _not_valid(f"variable {name[:100]!r} is of type {of[:100]!r}, which is not defined")
            variable = found.variables[name]
            if not variable.unit and self._declared[of]:
                found.variables[name] = replace(variable, unit=self._declared[of])
        return found

    def _root(self, tag: str, attributes: dict[str, str]) -> None:
        if tag != "fmiModelDescription":
            raise _not_valid(f"it begins with {tag[:100]!r}: expected 'fmiModelDescription'")
        version = attributes.get("fmiVersion", "")
        if not version.startswith(("2.", "3.")):
            raise FmuError(f"is of FMI {version[:20] or '(not said)'}: expected 2 or 3", "export it again")
        self._found.version = int(version[0])
        self._found.guid = attributes.get("guid" if version[0] == "2" else "instantiationToken", "")

    def _simulation(self, attributes: dict[str, str]) -> None:
        self._found.model = attributes.get("modelIdentifier", "")

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        name, reference = attributes.get("name"), attributes.get("valueReference", "")
        which = f"variable {len(self._found.variables) + 1}"
        if name is None:
            raise _not_valid(f"{which} has no name")
        if not (reference.isascii() and reference.isdecimal() and len(reference) <= 10 and int(reference) < 2**32):
            raise _not_valid(f"{which}, {name[:100]!r}, has the valueReference {reference[:20]!r}")
        if self._found.version == 3 and tag not in _TAGS_OF_FMI_3:
            raise _not_valid(f"{which}, {name[:100]!r}, is of type {tag[:100]!r}, which FMI has not")
        self._aliases = []
        causality, text = (
            attributes.get("causality", "local")[:_MOST_TEXT],
            attributes.get("description", "")[:_MOST_TEXT],
        )
        self._variable = UnitVariable(name, int(reference), "", causality, text)
        if self._found.version == 3:
            self._typed(tag, attributes)

    def _typed(self, kind: str, attributes: dict[str, str]) -> None:
        variable = self._variable
        assert variable is not None
        largest = attributes.get("max")
        number = None
        if largest is not None and kind in ("Real", "Float64"):
            number = _number(f"the max of {variable.name[:100]!r}", largest, endless=True)
        self._variable = replace(variable, type=kind, unit=attributes.get("unit", "")[:_MOST_TEXT], largest=number)
        if "declaredType" in attributes:
            self._of_type[variable.name] = attributes["declaredType"]

    def _take(self, variable: UnitVariable) -> None:
        if not variable.type:
            raise _not_valid(f"variable {variable.name[:100]!r} has no type")
        known = self._found.variables
        for name in (variable.name, *self._aliases):
            if name in known:
                raise _not_valid(f"two variables have the name {name[:100]!r}")
            known[name] = variable if name == variable.name else replace(variable, name=name)
        if self._aliases and variable.name in self._of_type:
            self._of_type |= dict.fromkeys(self._aliases, self._of_type[variable.name])
        if len(known) > MAX_VARIABLES:
            raise FmuError(f"has more than {MAX_VARIABLES} variables", "export it with fewer, such as the public ones")


def _base_unit(name: str, attributes: dict[str, str]) -> BaseUnit:
    def number(key: str, otherwise: float) -> float:
        return _number(f"{key} of unit {name[:100]!r}", attributes[key]) if key in attributes else otherwise

    kg, m, s = (number(key, 0.0) for key in ("kg", "m", "s"))
    others = any(number(key, 0.0) for key in ("A", "K", "mol", "cd"))
    if not all(value.is_integer() for value in (kg, m, s)):
        raise _not_valid(f"unit {name[:100]!r} has an exponent that is no whole number")
    return BaseUnit((int(kg), int(m), int(s)), others, number("factor", 1.0), number("offset", 0.0))


def _number(what: str, text: str, *, endless: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not (isfinite(value) or (endless and isinf(value))):
        raise _not_valid(f"{what} is {text[:50]!r}: expected a number")
    return value


def _not_valid(problem: str) -> FmuError:
    return FmuError(f"has a {DESCRIPTION} that is not valid: {problem}", "export it again")


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
