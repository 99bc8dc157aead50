"""The scenarios that ship with the package: their names, their texts, and what `fleet list` says about them.

The list is read from the top level of the YAML alone, without the schema, because it is asked for often and by people
who wait. A test compares it with the loaded scenarios.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from fleet.quantities import time_ns
from fleet.scenario.text.yaml_reader import Mapping, Scalar, Source, read

if TYPE_CHECKING:
    pass
from fleet.scenario.shipped_files import ShippedFiles

_FILES = ShippedFiles("fleet.scenario.shipped")


class ListedScenario(Struct, frozen=True):
    """One scenario that ships."""

    name: str
    group: Annotated[str, Meta(description="Empty: the file names none.")]
    title: str
    vehicles: int
    duration_s: float
    expect: Annotated[str, Meta(description="pass, or fail: it is meant to fail a check.")]


def shipped_scenarios() -> list[str]:
    """The names of the scenarios that come with the package."""
    return _FILES.names


def shipped_text(name: str) -> str:
    """The text of a shipped scenario, with its comments."""
    return _FILES.text(name)


def list_scenarios() -> list[ListedScenario]:
    """Every shipped scenario, by name."""
    return [_describe_scenario(name) for name in shipped_scenarios()]


def _describe_scenario(name: str) -> ListedScenario:
    root, _ = read(Source(name, shipped_text(name)))
    assert isinstance(root, Mapping), name
    top = {key: node.value for key, node in root.entries.items() if isinstance(node, Scalar)}
    vehicles = top["vehicles"]
    assert isinstance(vehicles, int), name
    duration_s = time_ns(top["duration"]) / 1e9
    words = {key: str(top.get(key, none)) for key, none in (("name", name), ("group", ""), ("expect", "pass"))}
    return ListedScenario(words["name"], words["group"], str(top["title"]), vehicles, duration_s, words["expect"])
