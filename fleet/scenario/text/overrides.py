"""`--set key.path=value`: changes to a scenario, made on the tree before it is validated.

So an override obeys the rules of the file, and a mistake in one is reported with those of the file. Steps
into a list count from 1, as vehicles do: `initial.2.surge=0.3 m/s`.

`vehicles=N` scales the scenario (see `scaling`), before the other overrides apply. `--show-config` shows the result.
"""

from __future__ import annotations

from collections.abc import Sequence

from fleet.errors import Problem
from fleet.quantities import describe_value
from fleet.scenario.text.scaling import scale
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Place, Scalar, Source, read

_MAX_STEPS = 10

Step = tuple[str, Place]


def override_name(override: str) -> str:
    """The name of an override in problems."""
    return f"--set {override}"


def apply(root: Mapping, overrides: Sequence[str]) -> tuple[Mapping, list[Problem]]:
    """The tree with the overrides applied in order, the later ones over the earlier, and their mistakes."""
    problems: list[Problem] = []
    changes: list[tuple[list[Step], Node]] = []
    for rank, override in enumerate(overrides, start=1):
        source = Source(override_name(override), override, rank)
        path, equals, _ = override.partition("=")
        if not equals or not all(path.split(".")) or path.count(".") > _MAX_STEPS:
            hint = "write key.path=value, such as network.period=50ms"
            problems.append(Place(source, 1, 1).problem("not an override", hint))
            continue
        value, mistakes = read(source, start=len(path) + 1)
        problems += mistakes
        if value is None:
            continue
        if path == "vehicles":
            root = scale(root, root.with_entry("vehicles", Place(source, 1, 1), value))
        else:
            changes.append((_steps(path, source), value))
    for steps, value in changes:
        try:
            changed = _set(root, steps, value)
        except _UnreachableError as error:
            problems.append(error.problem)
            continue
        assert isinstance(changed, Mapping)
        root = changed
    return root, problems


class _UnreachableError(Exception):
    """A path that leads through a value that is neither a mapping nor a list."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.message)
        self.problem = problem


def _steps(path: str, source: Source) -> list[Step]:
    steps, column = [], 1
    for key in path.split("."):
        steps.append((key, Place(source, 1, column)))
        column += len(key) + 1
    return steps


def _set(node: Node | None, steps: list[Step], value: Node) -> Node:
    """A copy of `node` with `value` at the end of the steps; missing mappings are made on the way."""
    if not steps:
        return value
    (key, place), rest = steps[0], steps[1:]
    if node is None or (isinstance(node, Scalar) and node.value is None):
        node = Mapping({}, {}, place)
    if isinstance(node, Mapping):
        return node.with_entry(key, place, _set(node.entries.get(key), rest, value))
    if isinstance(node, Items):
        index = int(key) if key.isascii() and key.isdigit() and len(key) < 6 else 0
        if not 1 <= index <= len(node.items):
            message = f'expected an entry of the list, from 1 to {len(node.items)}, got "{key}"'
            raise _UnreachableError(place.problem(message))
        items = list(node.items)
        items[index - 1] = _set(items[index - 1], rest, value)
        return Items(tuple(items), node.place)
    raise _UnreachableError(
        place.problem(f'there is no "{key}" here: the scenario has {describe_value(node.value)}, not a mapping')
    )
