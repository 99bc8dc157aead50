"""`fleet list`: the scenarios that ship, and the tables of add-ons below them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

import msgspec

from fleet.addon import parts
from fleet.scenario.catalogue import ListedScenario


class Listing:
    """What an add-on ships, as a table of `fleet list`.

    Attributes:
        key: its key in the document of `--json`.
        row: the struct of a row there.
        headings: of the columns; the last one alone wraps.
    """

    key: ClassVar[str]
    row: ClassVar[type[msgspec.Struct]]
    headings: ClassVar[tuple[str, ...]]

    def rows(self) -> Sequence[Any]:
        """All that ships, each as a `row`."""
        raise NotImplementedError

    def cells(self, row: Any) -> Sequence[str]:
        """A row as it is printed."""
        raise NotImplementedError


def listings() -> list[Listing]:
    """The tables of all add-ons."""
    return [kind() for kind in parts("listings")]


@cache
def document() -> type[msgspec.Struct]:
    """The struct that `--json` prints."""
    others = [(each.key, list[each.row]) for each in listings()]  # type: ignore[name-defined]
    made = msgspec.defstruct("Scenarios", [("scenarios", list[ListedScenario]), *others])
    made.__doc__ = "`fleet list --json`: the scenarios that ship with the package, and what add-ons ship."
    return made


def listed(scenarios: Sequence[ListedScenario], others: Mapping[str, Sequence[Any]]) -> msgspec.Struct:
    """What `--json` prints."""
    return document()(scenarios=scenarios, **others)


def __getattr__(name: str) -> Any:
    # The struct of the document depends on the add-ons that there are, so it is made when it is asked for.
    if name == "Listed":
        return document()
    raise AttributeError(name)
