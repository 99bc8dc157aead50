"""Commands from the parameters of their functions, each of which is declared once.

A positional parameter is an argument, and a keyword-only one an option. A parameter that is a dataclass or a struct
stands for its fields that have an `Option`. Beside the type of a parameter stand its `Option` and what else it needs:
a type of click that reads the text, a function that completes words, an `Effect`, or a `Fallback`:

    @command(document="fleet.logs.info.Info")
    def info(log: Log, *, since: Annotated[int, TIME, Option("Begin there.")] = 0, quiet: NoProgress = False) -> None:

An option without a default has to be given. With a document the command has `--json`.

A parameter with `FromAddOns` takes what add-ons bring to a command (`Extension`), and its options stand there:

    companions: Annotated[tuple[Companion, ...], FromAddOns("companions")]

A class of fields may name a module, `READER`, that reads their texts: `read(field, value)` and `texts_by_key(field,
texts)`.

Parameters are read as typer does it, and fields of dataclasses and structs as tyro does it. These libraries were
rejected: they import for longer than `fleet --help` takes (CPU, import and `--help` of one command: click 36 and 50 ms,
typer 62 and 240, tyro 67 and 140, cyclopts 72), and their help has no metavars with units and no examples. The document
is a text, because to import its struct would make each `--help` wait.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from functools import wraps
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeVar

import click

from fleet.addon import leave_out, sound_parts
from fleet.cli.documents.output import JSON
from fleet.cli.types import PACE, PATH, SECONDS, SHARE, SPEED, TIME, Effect, Fallback, Whole, is_given
from fleet.errors import FleetError
from fleet.option import NEEDED, Kind, OptionField, fields, holds_fields, option_from_annotation, unwrap

if TYPE_CHECKING:
    import msgspec

T = TypeVar("T")
_LAST = {"--json": 1, "--quiet": 2}  # in each help
_READERS: dict[tuple[Kind, Any], click.ParamType[Any]] = {
    (Kind.TEXT, str): click.STRING,
    (Kind.TEXT, int): click.INT,
    (Kind.TEXT, float): click.FLOAT,
    (Kind.TEXT, Path): PATH,
    (Kind.TIME, int): TIME,
    (Kind.TIME, float): SECONDS,
    (Kind.SPEED, float): SPEED,
    (Kind.SHARE, float): SHARE,
    (Kind.PACE, float): PACE,
}


class Extension:
    """What an add-on brings to a command: options of its own, and what they ask for.

    Attributes:
        options_type: a dataclass, whose fields with an `Option` become options of the command.
        commands: the names of the commands that have these options.
        options: what the user gave, an instance of `options_type`.
    """

    options_type: ClassVar[type]
    commands: ClassVar[tuple[str, ...]] = ()

    def __init__(self, options: Any) -> None:
        self.options = options

    @property
    def asked(self) -> bool:
        """Whether the user gave one of the options."""
        return any(is_given(name) for name in fields(type(self.options)))


class FromAddOns(NamedTuple):
    """Beside a parameter of a command: it takes the extensions of a kind, which is a field of `fleet.addon.AddOn`."""

    kind: str


class DeclaredCommand(click.Command):
    """A command, and the structs that `--json` prints by the words in front of it."""

    documents: Mapping[str, str] = {}

    def document_types(self) -> dict[str, type[msgspec.Struct]]:
        """The structs themselves, which are imported for it."""
        split = {words: path.rpartition(".") for words, path in self.documents.items()}
        return {words: getattr(import_module(module), name) for words, (module, _, name) in split.items()}


class _Taken(NamedTuple):
    """A parameter of a function: the fields that it is made of, and the struct, if it is one."""

    name: str
    fields: tuple[OptionField, ...]
    struct: Callable[..., Any] | None

    def value(self, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameter, from all that was given; nothing: its default holds."""
        found = {each.name: _build(each, given[each.name]) for each in self.fields if each.name in given}
        if self.struct is not None:
            return {self.name: self.struct(**found)}
        fallback = _first(self.fields[0], Fallback)
        return found if found or fallback is None else {self.name: fallback.find()}


def command(
    name: str | None = None, *, epilog: str | None = None, document: str | Mapping[str, str] = "",
    group: click.Group | None = None,
) -> Callable[[Callable[..., None]], DeclaredCommand]:  # fmt: skip
    """Make a function a command.

    Args:
        name: what the user types; by default the name of the function.
        epilog: what stands at the end of its help, such as examples.
        document: the struct that `--json` prints, as `module.Class`; of several, each by the words that ask for it.
        group: the command that it belongs to, as `certs` belongs to `hosts`; None: it is a verb of `fleet`.

    Returns:
        What makes the command of a function. The first line of the function's docstring is its help.

    Raises:
        KeyError: no type of the command line reads a parameter, which needs a `click.ParamType` beside its type.
    """

    def declare(function: Callable[..., None]) -> DeclaredCommand:
        taken: list[_Taken | _Extended] = []
        shown: list[click.Parameter] = []
        parameters = signature(function, eval_str=True).parameters.values()
        own = {each: None if _from_add_ons(each) else _taken_parameter(each) for each in parameters}
        flags = {"--json", "--help", "-h"} | {
            word for one in own.values() if one is not None for field in one.fields for word in _words(field)
        }
        for each, one in own.items():
            is_option = each.kind is Parameter.KEYWORD_ONLY
            if one is None:
                extended = _extend(each, name or function.__name__, flags)
                taken.append(extended)
                shown += map(_option, extended.fields)
                continue
            taken.append(one)
            shown += [_option(field) if is_option else _argument(field) for field in one.fields if field.flag]

        @wraps(function)
        def call(**values: Any) -> None:
            given = {name: value for name, value in values.items() if is_given(name)}
            arguments: dict[str, Any] = {}
            for one in taken:
                arguments |= one.value(given)
            function(**arguments)

        options = [*shown, *([JSON] if document else [])]
        options.sort(key=lambda each: _LAST.get(each.opts[-1], 0))
        make = click.command if group is None else group.command
        made = make(name, cls=DeclaredCommand, params=options, epilog=epilog)(call)
        assert isinstance(made, DeclaredCommand)
        if document:
            made.documents = {made.name or "": document} if isinstance(document, str) else document
        return made

    return declare


class _Extended(NamedTuple):
    """A parameter of a function that takes extensions."""

    name: str
    kinds: tuple[type[Extension], ...]

    @property
    def fields(self) -> list[OptionField]:
        """The options of all of them."""
        return [field for kind in self.kinds for field in fields(kind.options_type).values()]

    def value(self, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameter: each extension with its options, from all that was given."""
        made = []
        for kind in self.kinds:
            found = {name: given[name] for name in fields(kind.options_type) if name in given}
            made.append(kind(kind.options_type(**found)))
        return {self.name: tuple(made)}


def _words(field: OptionField) -> set[str]:
    """The flags of a field, and its name, which must be another one for each parameter."""
    return {field.name, *(word for part in (field.flag or "").split() for word in part.split("/"))}


def _from_add_ons(parameter: Parameter) -> FromAddOns | None:
    return next((each for each in unwrap(parameter.annotation)[1] if isinstance(each, FromAddOns)), None)


def _parameters_of(kind: type[Extension]) -> list[click.Option]:
    """The options of an extension. Raises whatever is wrong with them."""
    kind(kind.options_type())
    return [_option(field) for field in fields(kind.options_type).values()]


def _extend(parameter: Parameter, command: str, taken: set[str]) -> _Extended:
    """The extensions of a command. One with an option that is there already is left out, and hurts no other."""
    asked, found = _from_add_ons(parameter), []
    assert asked is not None
    for kind in sound_parts(asked.kind, _parameters_of):
        if command not in kind.commands:
            continue
        own = {word for field in fields(kind.options_type).values() for word in _words(field)}
        if there := own & taken:
            leave_out(f"{kind.__module__}:{kind.__name__}", f"fleet {command} has {min(there)} already")
            continue
        taken |= own
        found.append(kind)
    return _Extended(parameter.name, tuple(found))


def _taken_parameter(parameter: Parameter) -> _Taken:
    kind = parameter.annotation
    if holds_fields(kind):
        return _Taken(parameter.name, tuple(fields(kind).values()), kind)
    default = NEEDED if parameter.default is Parameter.empty else parameter.default
    return _Taken(parameter.name, (option_from_annotation(parameter.name, kind, default),), None)


def _argument(field: OptionField) -> click.Argument:
    needed = field.default is NEEDED and _first(field, Fallback) is None
    return click.Argument(
        [field.name], type=_type(field), nargs=-1 if _is_several(field) else 1, required=needed,
        metavar=field.option.metavar, help=field.option.help or None, shell_complete=_completion(field),
    )  # fmt: skip


def _option(field: OptionField) -> click.Option:
    assert field.flag is not None, field.name
    words, effects = [*field.flag.split(), field.name], [each for each in field.about if isinstance(each, Effect)]

    def act(context: click.Context, _: click.Parameter, value: Any) -> Any:
        for effect in effects if value else ():
            effect.act(context)
        return value

    about: dict[str, Any] = {"help": field.option.help, "callback": act if effects else None}
    if field.shape is bool:
        return click.Option(words, is_flag=True, **about)
    if field.option.alone is not None:
        about |= {"is_flag": False, "flag_value": field.option.alone}
    return ShownOption(
        words, field=field, type=_type(field), multiple=_is_several(field), required=field.default is NEEDED,
        metavar=field.option.metavar or field.kind.value, shell_complete=_completion(field), **about,
    )  # fmt: skip


class ShownOption(click.Option):
    """An option with a value, whose default its function knows."""

    def __init__(self, *words: Any, field: OptionField, **about: Any) -> None:
        super().__init__(*words, **about)
        self.field = field

    @property
    def shown(self) -> str:
        """The default as one types it, for the help; empty: there is none."""
        default = self.field.default
        if default is NEEDED:
            return ""
        return ", ".join(map(self._text, default)) if self.multiple else self._text(default)

    def _text(self, value: Any) -> str:
        if (write := getattr(self.type, "write", None)) is not None:
            return str(write(value))
        return "" if value is None else str(value.value if isinstance(value, Enum) else value)

    def get_help_extra(self, ctx: click.Context) -> Any:
        """What stands in brackets in the help."""
        extra = super().get_help_extra(ctx)
        return {**extra, "default": self.shown} if self.shown else extra


def _is_several(field: OptionField) -> bool:
    """Whether it is given once for each of its values. A type that stands beside the field reads all at once."""
    return field.shape in (dict, list, tuple) and _first(field, click.ParamType) is None


def _first(field: OptionField, kind: type[T]) -> T | None:
    return next((each for each in field.about if isinstance(each, kind)), None)


def _type(field: OptionField) -> click.ParamType[Any]:
    """What reads one value of a field."""
    given: click.ParamType[Any] | None = _first(field, click.ParamType)
    if given is not None:
        return given
    if field.shape is dict:
        return click.STRING
    if field.shape in (list, tuple):
        item = option_from_annotation(field.name, field.item)
        return _type(item) if field.kind is Kind.TEXT else _Checked(field)
    if field.shape is Literal:
        return click.Choice(field.words)
    if isinstance(field.shape, type) and issubclass(field.shape, Enum):
        return _Member(field.shape)
    if field.shape is int and field.limits != (None, None):
        return Whole(*field.limits)
    if field.shape is str and field.kind is not Kind.TEXT:
        return _Checked(field)
    return _READERS[field.kind, field.shape]


class _Member(click.Choice[str]):
    """A member of an enumeration, by its value."""

    def __init__(self, kind: type[Enum]) -> None:
        super().__init__([str(each.value) for each in kind])
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self._kind(super().convert(value, param, ctx))


class _Checked(click.ParamType[str]):
    """A text that the reader of its field checks."""

    def __init__(self, field: OptionField) -> None:
        self.name, self._field = field.name, field

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return str(import_module(self._field.reader).read(self._field, value))
        except FleetError as error:
            self.fail(str(error), param, ctx)


def _build(field: OptionField, value: Any) -> Any:
    """A value as the field holds it. Raises FleetError: the reader of its field does not take a text."""
    if field.shape is dict:
        return import_module(field.reader).texts_by_key(field, value)
    return list(value) if field.shape is list else value


def _completion(field: OptionField) -> Any:
    kinds = (click.ParamType, Effect, Fallback)
    return next((each for each in field.about if callable(each) and not isinstance(each, kinds)), None)
