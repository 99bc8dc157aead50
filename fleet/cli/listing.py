"""`fleet list`: the scenarios that ship, and the tables of add-ons below them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

import msgspec

from fleet.addon import leave_out, sound_parts
from fleet.errors import describe_error
from fleet.scenario.catalogue import ListedScenario


class Listing(ABC):
    """What an add-on ships, as a table of `fleet list`.

    Attributes:
        key: its key in the document of `--json`.
        row: the struct of a row there.
        headings: of the columns; the last one alone wraps.
    """

    key: ClassVar[str]
    row: ClassVar[type[msgspec.Struct]]
    headings: ClassVar[tuple[str, ...]]

    @abstractmethod
    def rows(self) -> Sequence[Any]:
        """All that ships, each as a `row`."""

    @abstractmethod
    def cells(self, row: Any) -> Sequence[str]:
        """A row as it is printed."""


@cache
def listings() -> tuple[Listing, ...]:
    """The tables of all add-ons that can be made, each with a key of its own."""
    found: dict[str, Listing] = {}
    for kind in sound_parts("listings", _try):
        if kind.key in (*found, "scenarios"):
            leave_out(f"{kind.__module__}.listings", f"there is a table {kind.key} already")
        else:
            found[kind.key] = kind()
    return tuple(found.values())


def _try(kind: type[Listing]) -> None:
    """Make the table, and the struct of its rows. Raises whatever is wrong with it."""
    made = kind()
    tuple(map(str.isprintable, made.headings))
    msgspec.json.schema(msgspec.defstruct("Trial", [(made.key, list[made.row])]))  # type: ignore[name-defined]


def fill_listings() -> dict[Listing, list[tuple[Any, Sequence[str]]]]:
    """The rows of each table, as the struct and as they are printed. A table that fails is left out."""
    found: dict[Listing, list[tuple[Any, Sequence[str]]]] = {}
    for each in listings():
        try:
            rows: list[tuple[Any, Sequence[str]]] = [(row, list(map(str, each.cells(row)))) for row in each.rows()]
            if any(len(cells) != len(each.headings) for _, cells in rows):
                raise ValueError(f"a row has not as many cells as there are headings ({len(each.headings)})")
        except Exception as error:
            leave_out(f"{type(each).__module__}.listings", f"{type(each).__name__}: {describe_error(error)}")
            rows = []
        found[each] = rows
    return found


@cache
def document() -> type[msgspec.Struct]:
    """The struct that `--json` prints."""
    others = [(each.key, list[each.row]) for each in listings()]  # type: ignore[name-defined]
    made = msgspec.defstruct("Scenarios", [("scenarios", list[ListedScenario]), *others])
    made.__doc__ = "`fleet list --json`: the scenarios that ship with the package, and what add-ons ship."
    return made


def listing_document(scenarios: Sequence[ListedScenario], others: Mapping[str, Sequence[Any]]) -> msgspec.Struct:
    """What `--json` prints."""
    return document()(scenarios=scenarios, **others)


def __getattr__(name: str) -> Any:
    # The struct of the document depends on the add-ons that there are, so it is made when it is asked for.
    if name == "Listed":
        return document()
    raise AttributeError(name)
