"""The declared messages and records as rows of a table: field, wire type, unit, meaning.

A wire type is uint, bool, str, bin, the name of a record or of an enumeration of texts, or an array of one of these or
of reals: `real[3]` of a declared length, `real[..2]` of at most one, `[*]` of any. A field that may stay open is `or
nil`.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple, get_args

from msgspec import inspect

from netem.causes import Cause
from netem.fault_kinds import WorldFaultKind
from netem.wire.declaring import Route, WireRecord
from netem.wire.messages import Message, TimedFault, WorldFault

_SCALARS: dict[type[inspect.Type], str] = {
    inspect.IntType: "uint",
    inspect.FloatType: "real",
    inspect.BoolType: "bool",
    inspect.StrType: "str",
    inspect.NoneType: "nil",
    inspect.BytesType: "bin",
}


class Field(NamedTuple):
    """One field of a message or record."""

    wire: str
    unit: str  # "" when it has none
    meaning: str


def declared() -> dict[str, tuple[type[WireRecord], Route]]:
    """Every kind of message with its class and its route, in the order of declaration."""
    return {cls.__struct_config__.tag: (cls, cls.route) for cls in get_args(Message)}


def records() -> dict[str, type[WireRecord | TimedFault]]:
    """Every record that a field may name, in the order of declaration."""
    found: list[type[WireRecord | TimedFault]] = [
        cls for cls in WireRecord.__subclasses__() if cls.__struct_config__.tag is None
    ]
    return {cls.__name__: cls for cls in (*found, WorldFault)}


def texts() -> dict[str, type[StrEnum]]:
    """Every enumeration of texts that a field may name."""
    return {cls.__name__: cls for cls in (Cause, WorldFaultKind)}


def fields_of(cls: type[WireRecord | TimedFault]) -> dict[str, Field]:
    """The fields of a message or record, in wire order."""
    info = inspect.type_info(cls)
    assert isinstance(info, inspect.StructType)
    return {field.name: _field(field.type) for field in info.fields}


def _field(declared: inspect.Type) -> Field:
    assert isinstance(declared, inspect.Metadata), "a field is declared with `about`"
    unit = (declared.extra or {})["unit"]
    meaning = (declared.extra_json_schema or {})["description"]
    return Field(_wire_type(declared.type), unit, meaning)


def _wire_type(declared: inspect.Type) -> str:
    match declared:
        case inspect.StructType(cls=cls) | inspect.EnumType(cls=cls):
            return cls.__name__
        case inspect.UnionType(types=types):
            return " or ".join(map(_wire_type, types))
        case inspect.VarTupleType(item_type=item, min_length=None, max_length=int(most)):
            return f"{_wire_type(item)}[..{most}]"
        case inspect.VarTupleType(item_type=item, min_length=size):
            return f"{_wire_type(item)}[{'*' if size is None else size}]"
    return _SCALARS[type(declared)]
