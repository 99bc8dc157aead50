"""The model description of an FMU: its XML is read in one pass, in a time and a memory that its size bounds.

fmpy's reader is not used. It validates with native code, whose time grows with the square of the mistakes (10 kB with
100,000 variables without names took minutes), and which no signal ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite, isinf
from xml.parsers import expat

from fleet.addons.fmu.fmu_archive import DESCRIPTION
from netem.limits import FMU_DESCRIPTION
from world.errors import FmuError

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
