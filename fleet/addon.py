"""Add-ons: packages that bring what the core does not need. Ours stand below `fleet.addons`; yours may be anywhere.

A package says in its pyproject.toml that it has one:

    [project.entry-points."uuv_fleet.addons"]
    tides = "tides:ADDON"

The object is an `AddOn`. It names modules in place of importing them, because each start of `fleet` reads it. Vehicles,
laws and checks have entry points of their own: `uuv_fleet.plants`, `uuv_fleet.controllers`, `uuv_fleet.checks`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from fleet.errors import describe_error, printable

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "uuv_fleet.addons"


class Verb(NamedTuple):
    """One command of `fleet`."""

    command: str  # `module:name` of a click command, such as `fleet.cli.declare.command` makes
    help: str  # the line of the command in `fleet --help`


@dataclass(frozen=True, kw_only=True, slots=True)
class AddOn:
    """What an add-on offers. A text is `module:name`, and is imported when somebody asks for it.

    Attributes:
        verbs: commands by the heading that they stand under in `fleet --help`, and by their name.
        names: what `import fleet` offers besides, by name: `fleet.plot`.
        companions: what goes beside a run, and the options of `fleet run` and others that ask for it
            (`fleet.cli.companion.Companion`).
        exporters: what `fleet export` writes besides tables (`fleet.cli.exporter.Exporter`).
        readers: what commands take in place of a log (`fleet.mcap.other.OtherData`).
        listings: further tables of `fleet list` (`fleet.cli.listing.Listing`).
        fault_kinds: kinds of faults (`fleet.scenario.faults.kind.FaultKind`).
        hints: what users of other tools, or of earlier versions, type in place of a verb, and what it is called here.
        other_options: options that users expect of a command, as `run --seeds`, and what does it.
    """

    verbs: Mapping[str, Mapping[str, Verb]] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    companions: tuple[str, ...] = ()
    exporters: tuple[str, ...] = ()
    readers: tuple[str, ...] = ()
    listings: tuple[str, ...] = ()
    fault_kinds: tuple[str, ...] = ()
    hints: Mapping[str, str] = field(default_factory=dict)
    other_options: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in PLACES:
            places = getattr(self, name)
            if not isinstance(places, tuple) or not all(isinstance(each, str) and ":" in each for each in places):
                raise TypeError(
                    f"{name}: expected a tuple of texts such as ('package.module:Class',), got {places!r:.80}"
                )
        for title, verbs in self.verbs.items():
            if not isinstance(verbs, Mapping) or not all(isinstance(verb, Verb) for verb in verbs.values()):
                raise TypeError(
                    f"verbs: expected {{heading: {{name: Verb(...)}}}}, got {verbs!r:.80} under {title!r:.40}"
                )


# The fields that hold places, and the class of what is there: one that inherits from it, or of faults an object.
PLACES = {
    "companions": "fleet.cli.companion:Companion",
    "exporters": "fleet.cli.exporter:Exporter",
    "readers": "fleet.mcap.other:OtherData",
    "listings": "fleet.cli.listing:Listing",
    "fault_kinds": "fleet.scenario.faults.kind:FaultKind",
}


class Installed(NamedTuple):
    """The add-ons of this environment.

    Attributes:
        addons: by the name of their entry point.
        left_out: why others are left out, by their names.
    """

    addons: Mapping[str, AddOn]
    left_out: dict[str, str]


@cache
def installed_addons() -> Installed:
    """The add-ons of this environment. One that cannot be imported is left out and hurts no other."""
    from importlib.metadata import entry_points  # here, because it takes as long as the rest of a command's start

    found, left_out = {}, {}
    for point in sorted(entry_points(group=GROUP), key=lambda each: (not _is_ours(each), each.name)):
        name, value = printable(point.name), printable(point.value)
        if point.name in found:
            left_out[f"{name} ({value})"] = "there is an add-on of this name already"
            continue
        try:
            addon = point.load()
        except (Exception, SystemExit) as error:
            left_out[name] = f"{value}: {describe_error(error)}"
            continue
        if not isinstance(addon, AddOn):
            left_out[name] = f"{value} is no fleet.addon.AddOn"
            continue
        found[point.name] = addon
    return Installed(found, left_out)


def _is_ours(point: EntryPoint) -> bool:
    """Whether it is an add-on of this package: those come first, so that no other takes a name of theirs."""
    return point.dist is not None and point.dist.name == "uuv-fleet"


def leave_out(what: str, reason: str) -> None:
    """Note that a part of an add-on cannot be used, for `fleet about` and for errors about what is missing.

    Args:
        what: the part, such as `tides.companions`.
        reason: why.
    """
    installed_addons().left_out[printable(what)] = printable(reason)


def load(place: str) -> Any:
    """What stands at a place.

    Args:
        place: `module:name`.

    Returns:
        The object of this name.

    Raises:
        ImportError: there is no such module, or it cannot be imported.
        AttributeError: the module has no such name.
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


@cache
def parts(kind: str) -> tuple[Any, ...]:
    """What all add-ons offer of a kind.

    Args:
        kind: a field of `AddOn` that has places, such as `exporters`.

    Returns:
        The objects at these places, our own first. What cannot be loaded, or is of another form, is left out.
    """
    found, base = [], load(PLACES[kind])
    for name, addon in installed_addons().addons.items():
        for place in getattr(addon, kind):
            try:
                part = load(place)
                problem = _problem(part, base, is_object=kind == "fault_kinds")
            except (Exception, SystemExit) as error:
                problem = describe_error(error)
            if problem:
                leave_out(f"{name}.{kind}", f"{place}: {problem}")
            else:
                found.append(part)
    return tuple(found)


def _problem(part: Any, base: type, *, is_object: bool) -> str:
    """Why a part cannot be used; empty: it inherits from its class, and has all that it must have."""
    about = type(part) if is_object else part
    if not isinstance(about, type) or not issubclass(about, base):
        return f"expected {'an object' if is_object else 'a class'} of {base.__module__}.{base.__name__}"
    wanted = {name for each in base.__mro__ for name in vars(each).get("__annotations__", {})}
    wanted |= getattr(about, "__abstractmethods__", frozenset())
    missing = [n for n in sorted(wanted) if not hasattr(part, n) or n in getattr(about, "__abstractmethods__", ())]
    return f"it has no {', '.join(missing)}" if missing else ""


def sound_parts(kind: str, probe: Callable[[Any], object]) -> Iterator[Any]:
    """The parts of a kind with which a trial goes well; each other is left out, and hurts nobody.

    Args:
        kind: a field of `AddOn` that has places.
        probe: what will be done with a part.
    """
    for part in parts(kind):
        try:
            probe(part)
        except (Exception, SystemExit) as error:
            leave_out(f"{part.__module__}.{kind}", f"{part!r:.80}: {describe_error(error)}")
        else:
            yield part
