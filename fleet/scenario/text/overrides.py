"""`--set key.path=value`: changes to a scenario, made on the tree before it is validated.

So an override obeys the rules of the file, and a mistake in one is reported with those of the file. Steps
into a list count from 1, as vehicles do: `initial.2.surge=0.3 m/s`.

`vehicles=N` scales the scenario, before the other overrides apply. What the file writes out vehicle by vehicle
cannot fit another number of them, so it is replaced by what can: the formation's offsets by a grid, the
initial states by a scatter, the graph's edges by a path (a shape scales by itself). What is said of links and
vehicles that may be gone is dropped, and so are faults and changes of the formation, whose ways grow with the fleet.
`--show-config` shows the result.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from fleet.errors import Problem
from fleet.quantities import QuantityError, describe, vehicle_numbers
from fleet.scenario.schema.shapes import DEFAULT_SPACING_M
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Place, Scalar, Source, plain, read

_MAX_STEPS = 10
# The tuning "paper" is fragile in its disturbance: 20 vehicles survive this start, at 1 m one of them tumbles,
# and of 100 vehicles one tumbles even so (seed 1). Undisturbed and hardened fleets of 100 survive.
_SCATTER_M = 0.5

Step = tuple[str, Place]


def override_name(override: str) -> str:
    """What problems call the source of an override."""
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
        value, found = read(source, start=len(path) + 1)
        problems += found
        if value is None:
            continue
        if path == "vehicles":
            root = _scale(root, root.with_entry("vehicles", Place(source, 1, 1), value))
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
    """A path that leads through something that is no mapping or list."""

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
        place.problem(f'there is no "{key}" here: the scenario has {describe(node.value)}, not a mapping')
    )


def _scale(before: Mapping, root: Mapping) -> Mapping:
    """The tree for another number of vehicles than it was written for."""
    old, new = _count(before), _count(root)
    if new is None or old == new:
        return root
    place = root.keys["vehicles"]

    def scalar(value: str | float) -> Scalar:
        return Scalar(value, place)

    def replaced(root: Mapping, key: str, entries: dict[str, Node]) -> Mapping:
        old = root.entries.get(key)
        keys = dict.fromkeys(entries, place) | (old.keys if isinstance(old, Mapping) else {})
        return root.with_entry(key, root.keys[key], Mapping(entries, keys, place))

    formation = root.entries.get("formation")
    if isinstance(formation, Mapping) and "offsets" in formation.entries:
        entries: dict[str, Node] = {"shape": scalar("grid"), "spacing": scalar(f"{DEFAULT_SPACING_M:g} m")}
        root = replaced(root, "formation", entries)
    elif isinstance(formation, Mapping) and "changes" in formation.entries:
        root = replaced(root, "formation", {k: v for k, v in formation.entries.items() if k != "changes"})
    for written_for_so_many in ("faults", "expect"):
        if written_for_so_many in root.entries:
            root = root.without(written_for_so_many)
    checks = root.entries.get("checks")
    if isinstance(checks, Mapping):
        for name, check in checks.entries.items():
            links = check.entries.get("links") if isinstance(check, Mapping) else None
            some = isinstance(links, Scalar) and bool(_numbers(str(links.value)))
            if name == "recovery_time" or some or (isinstance(check, Mapping) and "vehicles" in check.entries):
                checks = checks.without(name)
        root = root.with_entry("checks", root.keys["checks"], checks)
    per_vehicle = root.entries.get("per_vehicle")
    if isinstance(per_vehicle, Mapping):
        for text in per_vehicle.entries:
            if any(int(n) > new for n in _numbers(text)):
                per_vehicle = per_vehicle.without(text)
        root = root.with_entry("per_vehicle", root.keys["per_vehicle"], per_vehicle)
    initial = root.entries.get("initial")
    if isinstance(initial, Items):
        entries = {"scatter": scalar(f"{_SCATTER_M} m")}
        first = initial.items[0] if initial.items else None
        if isinstance(first, Mapping) and "surge" in first.entries:
            entries["surge"] = first.entries["surge"]
        root = replaced(root, "initial", entries)
    graph = root.entries.get("graph")
    explicit = isinstance(graph, Mapping) and "edges" in graph.entries
    if isinstance(graph, Mapping):
        root = replaced(root, "graph", _scaled_graph(graph, explicit, new, scalar("path")))
    network = root.entries.get("network")
    links = network.entries.get("links") if isinstance(network, Mapping) else None
    if isinstance(network, Mapping) and isinstance(links, Mapping):
        for selector in links.entries:
            numbers = [int(n) for n in _numbers(selector)]
            if numbers and (explicit or max(numbers) > new):
                links = links.without(selector)
        root = root.with_entry("network", root.keys["network"], network.with_entry("links", place, links))
    return root


def _scaled_graph(graph: Mapping, explicit: bool, vehicles: int, path: Scalar) -> dict[str, Node]:
    entries = {key: node for key, node in graph.entries.items() if key != "edges"}
    if explicit:
        entries["shape"] = path
    for key, most in (("hub", vehicles), ("count", vehicles - 1)):
        if key in entries and _above(entries[key], most):
            del entries[key]
    standby = entries.get("standby")
    who = standby.entries.get("vehicles") if isinstance(standby, Mapping) else None
    if isinstance(who, Scalar) and any(int(n) > vehicles for n in _numbers(str(who.value))):
        del entries["standby"]
    followers = entries.get("reference")
    if isinstance(followers, Scalar) and followers.value != "all":
        followers = _listed(followers)
    if isinstance(followers, Items):
        kept = tuple(n for n in followers.items if not _above(n, vehicles))
        entries["reference"] = Items(kept, followers.place)
    return entries


def _listed(named: Scalar) -> Node:
    """Vehicles such as `2-4, 7` one by one; what names none stays as it is, for the error that it will be."""
    try:
        numbers = vehicle_numbers(str(named.value))
    except QuantityError:
        return named
    return Items(tuple(Scalar(n, named.place) for n in numbers), named.place)


def _above(node: Node, vehicles: int) -> bool:
    return isinstance(node, Scalar) and type(node.value) is int and node.value > vehicles


def _count(root: Mapping) -> int | None:
    value = plain(root.entries["vehicles"]) if "vehicles" in root.entries else None
    return value if type(value) is int and value > 0 else None


def _numbers(selector: str) -> list[str]:
    return re.findall(r"\d{1,9}", selector, re.ASCII)
