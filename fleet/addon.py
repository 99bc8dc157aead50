"""Add-ons: packages that bring what the core does not need. Ours stand below `fleet.addons`; yours may be anywhere.

A package says in its pyproject.toml that it has one:

    [project.entry-points."uuv_fleet.addons"]
    tides = "tides:ADDON"

The object is an `AddOn`. It names modules in place of importing them, because each start of `fleet` reads it. Vehicles,
laws and checks have entry points of their own: `uuv_fleet.plants`, `uuv_fleet.controllers`, `uuv_fleet.checks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

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
        readers: what commands take in place of a log (`fleet.logs.other.OtherData`).
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


class Installed(NamedTuple):
    """The add-ons of this environment.

    Attributes:
        addons: by the name of their entry point.
        left_out: why others are left out, by their names.
    """

    addons: Mapping[str, AddOn]
    left_out: Mapping[str, str]


@cache
def installed() -> Installed:
    """The add-ons of this environment. One that cannot be imported is left out and hurts no other."""
    from importlib.metadata import entry_points  # here, because it takes as long as the rest of a command's start

    found, left_out = {}, {}
    for point in sorted(entry_points(group=GROUP), key=lambda each: each.name):
        try:
            addon = point.load()
        except Exception as error:
            left_out[point.name] = f"{point.value}: {type(error).__name__}: {error}"
            continue
        if not isinstance(addon, AddOn):
            left_out[point.name] = f"{point.value} is no fleet.addon.AddOn"
            continue
        found[point.name] = addon
    return Installed(found, left_out)


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
        The objects at these places, in the order of the add-ons' names.

    Raises:
        ImportError: a module of an add-on cannot be imported.
    """
    assert kind in {each.name for each in fields(AddOn)}, kind
    return tuple(load(place) for addon in installed().addons.values() for place in getattr(addon, kind))
