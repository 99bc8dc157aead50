"""Options that are declared once: a field, or a parameter of a command, with its type, its default and an `Option`.

The command line, the keywords of Python, the keys of files and the documentation follow from it. `fleet.cli.declare`
makes the command line. This module imports little, because every `--help` waits for it.
"""

from __future__ import annotations

import builtins
import sys
from dataclasses import MISSING, is_dataclass
from enum import Enum
from inspect import get_annotations
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints


class Kind(Enum):
    """The kinds of texts. The value of a kind stands for the text in `--help`.

    The types of `fleet.cli.types` read those of a field that is a number: a TIME in s, or in whole ns; a SPEED, a SHARE
    or a PACE. A command brings its own reader for the others (`fleet.cli.declare.command`).
    """

    TEXT = None
    SCENARIO = "SCENARIO"
    TIME = "TIME"  # a script gives seconds
    SPEED = "X|MAX"
    SHARE = "SHARE"
    PACE = "X"
    SEEDS = "SEEDS"
    VALUES = "KEY=VALUES"
    ALONG = "KEY=LOW..HIGH"
    VALUE = "KEY=VALUE"
    MEASURE = "NAME"
    CHECK = "CHECK"
    CONDITION = "'LINKS CONDITION'"
    FAULT = "'at TIME ...'"
    UNTIL = "'pass ±5 %'"


class Option(NamedTuple):
    """The words about a field, and its names."""

    help: str  # text for `--help` and for Python's `help`
    metavar: str | None = None  # the word for the value, if the type of the field has none
    flag: str | None = ""  # several with spaces between; "": `--` and the name of the field; None: no option
    keyword: str = ""  # in Python; "": the name of the field
    later: bool = False  # whether a study that continues may change it
    alone: str | None = None  # the value of an option that nothing follows; None: something has to


class Limits(NamedTuple):
    """The least and the largest number; None: there is none. A `Meta` of msgspec says the same."""

    ge: int | None = None
    le: int | None = None


NEEDED: Any = object()  # the default of a field that has none


class OptionField(NamedTuple):
    """A field, or a parameter, with its `Option`."""

    name: str
    shape: Any  # `dict`: texts by key; `list`, `tuple`: several values; else the type of its one value, or Literal
    kind: Kind  # the kind of its texts
    default: Any
    option: Option
    limits: tuple[int | None, int | None]
    words: tuple[str, ...]  # the words of a Literal
    about: tuple[Any, ...]  # all else that stands beside the type
    item: Any  # the annotation of one of several values
    reader: str = ""  # the module that reads texts of the kinds that no type of the command line reads

    @property
    def flag(self) -> str | None:
        """The option on the command line; None: a file alone has it."""
        return f"--{self.name.replace('_', '-')}" if self.option.flag == "" else self.option.flag

    @property
    def keyword(self) -> str:
        """The keyword in Python. That of a time ends with its unit, `_s`."""
        return self.option.keyword or (f"{self.name}_s" if self.kind is Kind.TIME else self.name)


def option_from_annotation(name: str, annotation: Any, default: Any = NEEDED) -> OptionField:
    """A field, or a parameter of a function, as its annotation declares it.

    Args:
        name: of the field.
        annotation: its type, `Annotated` with an `Option`, a `Kind` or limits.
        default: its default; `NEEDED`: it has none.

    Returns:
        All that the command line, the keywords and the keys of files follow from.
    """
    shape, about = unwrap(annotation)
    return OptionField(
        name,
        get_origin(shape) or shape,
        next((each for each in about if isinstance(each, Kind)), Kind.TEXT),
        default,
        next((each for each in about if isinstance(each, Option)), Option("")),
        next(((each.ge, each.le) for each in about if hasattr(each, "ge")), (None, None)),
        get_args(shape) if get_origin(shape) is Literal else (),
        about,
        next(iter(get_args(shape)), str),
    )


def fields(kind: type) -> dict[str, OptionField]:
    """The fields of a dataclass or a struct that have an `Option`.

    Args:
        kind: the dataclass or the struct. A type in it that only the type checker imports stands for any type.

    Returns:
        The fields by name, those of base classes first.
    """
    found = {}
    for owner in reversed(kind.__mro__):
        names = _Names(vars(sys.modules[owner.__module__]))
        hints = get_type_hints(owner, {}, names, include_extras=True)
        for name in get_annotations(owner):
            field = option_from_annotation(name, hints[name], default_of(kind, name))._replace(
                reader=getattr(kind, "READER", "")
            )
            if any(isinstance(each, Option) for each in field.about):
                found[name] = field
    return found


class _Names(dict[str, Any]):
    """The names of a module. Those that only the type checker imports stand for any type."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, object)


def holds_fields(kind: Any) -> bool:
    """Whether it is a dataclass or a struct."""
    return isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "__struct_fields__"))


def default_of(kind: Any, name: str) -> Any:
    """The default of a field.

    Args:
        kind: the dataclass or the struct.
        name: of the field.

    Returns:
        The default; `NEEDED`: the field has none.
    """
    if is_dataclass(kind):
        field = kind.__dataclass_fields__[name]
        made = field.default if field.default_factory is MISSING else field.default_factory()
        return NEEDED if made is MISSING else made
    from msgspec import NODEFAULT, structs

    (info,) = (each for each in structs.fields(kind) if each.name == name)
    made = info.default if info.default_factory is NODEFAULT else info.default_factory()
    return NEEDED if made is NODEFAULT else made


def unwrap(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """The type in an annotation.

    Args:
        annotation: a type, `Annotated` or not.

    Returns:
        The type without `| None`, and what stands beside it in `Annotated`.
    """
    about: tuple[Any, ...] = ()
    while True:
        if get_origin(annotation) is Annotated:
            annotation, *more = get_args(annotation)
            about = (*about, *more)
        elif get_origin(annotation) in (Union, UnionType) and NoneType in get_args(annotation):
            annotation = next(each for each in get_args(annotation) if each is not NoneType)
        else:
            return annotation, about
