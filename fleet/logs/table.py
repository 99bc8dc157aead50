"""The table of a topic: a column for the time and one for each number, so that every column has one unit.

The first column is `t [s]`, the time at which the message was logged. Every other column is a field of the log; the
components of a vector each have their index: `tau_0 [N]`. A topic whose messages hold lists of messages
(`transforms`, `scene`) is no table.
"""

from __future__ import annotations

from collections.abc import Collection
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fleet.errors import FleetError
from fleet.logs.columns import objects
from fleet.logs.topic import Topic
from fleet.mcap.records import Array
from fleet.scenario.sections.signals import component

if TYPE_CHECKING:
    pass


def require(what: str, packages: tuple[str, ...], extra: str) -> None:
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        listed = f"{', '.join(missing)}, which {'is' if len(missing) == 1 else 'are'} not installed"
        raise FleetError(f"{what} needs {listed}: pip install 'uuv-fleet[{extra}]'")


class TableColumn(NamedTuple):
    name: str
    unit: str
    meaning: str
    values: Array  # (samples,)

    @property
    def heading(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def holds(self, kind: type[Any]) -> bool:
        return self.values.dtype == object and any(isinstance(value, kind) for value in self.values)


def columns(topic: Topic, undivided: Collection[str] = ()) -> list[TableColumn]:
    """The table of what is held of a topic; the time comes first. Vectors in `undivided` stay one column. Raises
    LogReadError if its messages cannot be decoded, or are too many to be held.
    """
    found = [TableColumn("t", "s", "when the message was logged, in simulated time", topic.t)]
    for name in topic.fields:
        values = topic[name]
        if name in undivided and values.ndim > 1:
            values = objects(map(tuple, values.tolist()))
        unit, meaning = topic.declaration(name)
        name = "t_" if name == "t" else name
        if values.ndim == 1:
            found.append(TableColumn(name, unit, meaning, values))
            continue
        parts = [part.strip() for part in unit.split(",")]
        if len(parts) != values.shape[1]:
            parts = [unit] * values.shape[1]
        found += [
            TableColumn(component(name, k), unit, meaning, np.ascontiguousarray(values[:, k]))
            for k, unit in enumerate(parts)
        ]
    return found


def fits(topic: Topic) -> bool:
    """Whether a topic has a message and each is a row of values."""
    return bool(len(topic)) and not topic.nested
