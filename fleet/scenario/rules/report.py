"""The report that rules write their problems into, each at its place in the text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from fleet import quantities
from fleet.errors import Problem
from fleet.quantities import show_time, vehicle_numbers
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.per_vehicle import Entries
from fleet.scenario.text.yaml_reader import Mapping, locate
from fleet.scenario.trust import READING, Policy
from netem.condition import Link

LINKS_SHOWN = 12


def dotted_path(path: Sequence[str | int]) -> str:
    """A path as `--set` writes it: entries of a list count from 1."""
    return ".".join(str(step + 1) if isinstance(step, int) else step for step in path)


@dataclass
class Report:
    """The problems found so far in the tree of one scenario."""

    root: Mapping  # the tree
    problems: list[Problem] = field(default_factory=list)
    policy: Policy = READING
    _added: set[Problem] = field(default_factory=set)

    def add(self, path: tuple[str | int, ...], message: str, hint: str = "", *, key: bool = False) -> None:
        """Report a mistake, once, at the value (or the key) at `path`, or at its nearest ancestor that is there."""
        path = self._written(path)
        name = dotted_path(path)
        problem = locate(self.root, path, key=key).problem(f"{name}: {message}", hint, name)
        if problem not in self._added:
            self._added.add(problem)
            self.problems.append(problem)

    def refuse(self, path: tuple[str | int, ...], message: str, hint: str) -> None:
        """Report a law that may not run: as a mistake, or where the policy collects such laws."""
        if self.policy.refused is None:
            self.add(path, message, hint)
        else:
            place, name = locate(self.root, self._written(path)), dotted_path(path)
            self.policy.refused.append(place.problem(f"{name}: {message}", hint, name))

    def typed(self, path: tuple[str | int, ...]) -> bool:
        """Whether the value at `path` was given on the command line."""
        return locate(self.root, self._written(path)).source.rank > 0

    def mistaken(self, *keys: str) -> bool:
        """Whether a mistake in one of these sections has been reported."""
        return any(problem.message.startswith(keys) for problem in self.problems)

    def add_missing(self, path: tuple[str | int, ...], key: str, why: str) -> None:
        """Report a key that a section should have."""
        place = locate(self.root, path, key=True)
        missing = place.problem(f'"{key}" is missing in "{dotted_path(path)}"{why}', key=dotted_path((*path, key)))
        self.problems.append(missing)

    def has(self, path: tuple[str, ...]) -> bool:
        """Whether the tree has a value at `path`."""
        node: Any = self.root
        for step in self._written(path):
            if not isinstance(node, Mapping) or step not in node.entries:
                return False
            node = node.entries[step]
        return True

    def keys(self, *path: str) -> list[str]:
        """The keys of the mapping at `path`, as written."""
        node = self.root
        for step in path:
            below = node.entries.get(step)
            if not isinstance(below, Mapping):
                return []
            node = below
        return list(node.entries)

    def origin(self, entries: Entries, *path: str) -> tuple[str, ...] | None:
        """The path of a value that holds for some vehicles: in the last of their entries that has it, or for all."""
        places = [*(("per_vehicle", numbers, *path) for numbers in reversed(entries)), path]
        return next((place for place in places if self.has(place)), None)

    def _written(self, path: tuple[Any, ...]) -> tuple[Any, ...]:
        """`path` with its vehicle numbers as the file writes them, spaces included."""
        if len(path) < 2 or path[0] != "per_vehicle" or path[1] in self.keys("per_vehicle"):
            return path
        text = next((text for text in self.keys("per_vehicle") if number_text(text) == path[1]), path[1])
        return (path[0], text, *path[2:])


def number_text(numbers: str) -> str:
    """Vehicle numbers as the schema keeps them."""
    return "".join(numbers.split())


def whole_multiple(report: Report, path: tuple[str | int, ...], ns: int, tick: int) -> None:
    """Report a time that is not a whole number of ticks."""
    if wrong := no_whole_ticks(ns, tick):
        report.add(path, *wrong)


def no_whole_ticks(ns: int, tick: int) -> tuple[str, str] | None:
    """Message and hint for a time [ns] that is not a whole number of ticks; None if it is one."""
    if ns % tick == 0:
        return None
    below = ns // tick * tick
    near = " or ".join(show_time(t) for t in (below, below + tick) if t)
    return f"{show_time(ns)} is not a whole number of ticks of {show_time(tick)}", f"nearest: {near}"


def known_links(links: Sequence[Link]) -> str:
    """A hint with the first links of a graph."""
    shown = ", ".join(f"{src}->{dst}" for src, dst in links[:LINKS_SHOWN])
    more = f" and {len(links) - LINKS_SHOWN} more" if len(links) > LINKS_SHOWN else ""
    return f"links: {shown}{more}"


def unknown_vehicle(spec: ScenarioSpec, number: int) -> str:
    """What is wrong with the number of a vehicle; "": the scenario has it."""
    if 1 <= number <= spec.vehicles:
        return ""
    return quantities.unknown_vehicle(number, spec.vehicles).in_names(tuple(spec.nodes or ()))


def vehicles_exist(
    spec: ScenarioSpec, report: Report, path: tuple[str | int, ...], text: str, *, key: bool = False
) -> None:
    """Report the first vehicle in `text` that the scenario does not have."""
    if wrong := next(filter(None, (unknown_vehicle(spec, number) for number in vehicle_numbers(text))), ""):
        report.add(path, wrong, key=key)
