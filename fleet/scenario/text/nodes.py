"""Scenarios with nodes: names in place of numbers, and the keys of vehicles that nodes do not have.

Inside, nodes are vehicles 1, 2, ... in the order of the file. So graph, network, faults and checks are those of every
scenario. `nodes_to_vehicles` puts numbers in place of names, and `vehicles_to_nodes` is its inverse.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import cos, pi, sin
from typing import Any

from fleet.errors import Problem
from fleet.quantities import LENGTH, QuantityError, vector
from fleet.scenario.schema.nodes import NAME, RESERVED
from fleet.scenario.sections.node_names import FREE, to_numbers, values_to_names
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, TextPlace
from netem.parsing import nearest

KEYS = (
    "name", "title", "nodes", "programs", "compose", "begin", "signals", "carry", "discovery", "lost_after", "header",
    "fragments", "isolate", "clock", "duration", "tick", "seed",
    "graph", "network", "faults", "nemesis", "checks", "log", "expect", "group", "stall_timeout",
)  # fmt: skip
UNTIL_STOPPED_NS = 86_400 * 10**9
UNTIL_STOPPED = "86400 s"
TICK, TICK_IN_WATER = "1 ms", "10 ms"
_ROUND = "100 ms"
_RADIUS_M = 50.0  # nodes without a place are drawn on a circle of this radius
_LIKE = 0.75  # a key and the one that was meant: `signal` and `signals`, and not `formation` and `duration`
_SECTIONS = ("graph", "network", "faults", "nemesis", "checks")
_EDGE = re.compile(r"\s*(\w+)\s*(<->|->|-)\s*(\w+)\s*", re.ASCII)


def nodes_to_vehicles(root: Mapping, problems: list[Problem]) -> Mapping:
    """The tree of a scenario with nodes as that of one with vehicles; mistakes in names are added to `problems`."""
    root = _spread_isolate(root)
    nodes = root.entries["nodes"]
    if not isinstance(nodes, Mapping):
        return root
    for key in root.entries:
        if key not in (*KEYS, *_ADDED):
            near = [known for known in KEYS if known not in root.entries and nearest(key, [known], _LIKE)]
            hint = f'did you mean "{near[0]}"?' if near else f"known beside nodes: {', '.join(KEYS[2:-2])}"
            problems.append(root.keys[key].problem(f'"{key}" has no meaning for nodes', hint, key))
            if near:  # what names its entries is no further mistake
                root = root.with_entry(near[0], root.keys[key], root.entries[key])
            root = root.without(key)
    names = [name for name in nodes.entries if NAME.fullmatch(name) and name not in RESERVED]
    expand = _Expanded(names, problems)
    for key in _SECTIONS:
        if key in root.entries:
            root = root.with_entry(key, root.keys[key], expand.node(root.entries[key]))
    if isinstance(graph := root.entries.get("graph"), Mapping):
        if "edges" in graph.entries:
            graph = graph.with_entry("edges", graph.keys["edges"], expand.edges(graph.entries["edges"]))
        if "reference" not in graph.entries:
            # Whom the check `connected` asks to reach.
            graph = graph.with_entry("reference", graph.place, _tree([1], graph.place))
        root = root.with_entry("graph", root.keys["graph"], graph)
    if "checks" in root.entries:
        root = root.with_entry("checks", root.keys["checks"], _with_whole_signal_names(root.entries["checks"], root))
    network = root.entries.get("network")
    said = network.entries if isinstance(network, Mapping) else [network.value] if isinstance(network, Scalar) else ()
    for key, value in _added_keys(nodes, water="acoustic" in said).items():
        if key not in root.entries:
            root = root.with_entry(key, nodes.place, _tree(value, nodes.place))
    return root


def _spread_isolate(root: Mapping) -> Mapping:
    """The tree with `isolate` at each node, if it is given for all."""
    nodes, all_of_them = root.entries["nodes"], root.entries.get("isolate")
    if all_of_them is None or not isinstance(nodes, Mapping):
        return root
    for name, node in nodes.entries.items():
        if isinstance(node, Mapping) and "isolate" not in node.entries:
            one = Mapping(node.entries | {"isolate": all_of_them}, node.keys | {"isolate": node.place}, node.place)
            nodes = Mapping(nodes.entries | {name: one}, nodes.keys, nodes.place)
    return root.with_entry("nodes", root.keys["nodes"], nodes).without("isolate")


def with_moored_defaults(root: Mapping) -> Mapping:
    """The tree of a scenario with what moored vehicles may leave out, and others may not."""
    moored = root.entries.get("moored")
    if not isinstance(moored, Scalar) or moored.value is not True:
        return root
    network = root.entries.get("network")
    period = network.entries.get("period") if isinstance(network, Mapping) else None
    added = {key: _tree(value, moored.place) for key, value in _MOORED.items()}
    for key, node in (added | ({} if period is None else {"tick": period})).items():
        if key not in root.entries:
            root = root.with_entry(key, moored.place, node)
    return root


def _with_whole_signal_names(checks: Node, root: Mapping) -> Node:
    """The checks with whole names of signals: those of nodes are named alone."""
    told = root.entries.get("signals")
    if not (isinstance(checks, Mapping) and isinstance(told, Mapping) and "signal" in checks.entries):
        return checks

    def whole(node: Node) -> Node:
        if isinstance(node, Items):
            return Items(tuple(map(whole, node.items)), node.place)
        topic = node.entries.get("topic") if isinstance(node, Mapping) else None
        if isinstance(node, Mapping) and isinstance(topic, Scalar) and topic.value in told.entries:
            return node.with_entry("topic", node.keys["topic"], Scalar(f"control.{topic.value}", topic.place))
        return node

    return checks.with_entry("signal", checks.keys["signal"], whole(checks.entries["signal"]))


class _Expanded:
    """Puts numbers in place of names."""

    def __init__(self, names: Sequence[str], problems: list[Problem]) -> None:
        self._names, self._problems = names, problems

    def node(self, node: Node) -> Node:
        if isinstance(node, Items):
            return Items(tuple(map(self.node, node.items)), node.place)
        if isinstance(node, Scalar):
            if not isinstance(node.value, str):
                return node
            if node.value in self._names:  # a number where vehicles have one
                return Scalar(self._names.index(node.value) + 1, node.place, node.text)
            return Scalar(self._text(node.value, node.place), node.place, node.text)
        found = Mapping({}, {}, node.place)
        for key, value in node.entries.items():
            place = node.keys[key]
            found = found.with_entry(self._text(key, place), place, value if key in FREE else self.node(value))
        return found

    def edges(self, node: Node) -> Node:
        """`[a-b, a->c]` as the links of each."""
        if not isinstance(node, Items):
            return node
        found = Mapping({}, {}, node.place)
        for item in node.items:
            text = item.value if isinstance(item, Scalar) else None
            edge = _EDGE.fullmatch(text) if isinstance(text, str) else None
            if edge is None:
                hint = "write auv1-auv2 for both ways, or auv1->auv2"
                self._problems.append(item.place.problem("expected an edge between two nodes", hint, "graph.edges"))
                continue
            a, arrow, b = edge.groups()
            one = Scalar(1.0, item.place)
            found = found.with_entry(f"{a}->{b}", item.place, one)
            if arrow != "->":
                found = found.with_entry(f"{b}->{a}", item.place, one)
        return found

    def _text(self, text: str, place: TextPlace) -> str:
        try:
            return to_numbers(text, self._names)
        except KeyError as error:
            known = f"the nodes are {', '.join(self._names)}"
            self._problems.append(place.problem(f"there is no node {error.args[0]}", known))
            return text


def vehicles_to_nodes(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a specification with nodes as its file has them."""
    names = list(values["nodes"])
    kept = {key: values[key] for key in KEYS if key in values}
    if kept.get("duration") == UNTIL_STOPPED:
        del kept["duration"]
    kept["nodes"] = {
        name: {key: value for key, value in node.items() if value != {}} for name, node in values["nodes"].items()
    }
    kept["log"] = {key: value for key, value in kept["log"].items() if key != "every"}
    kept |= {key: values_to_names(kept[key], names) for key in _SECTIONS if key in kept}
    graph = kept["graph"]
    if "edges" in graph:
        graph["edges"] = list(graph["edges"])
    if graph["reference"] == [1]:
        del graph["reference"]
    return kept


def _added_keys(nodes: Mapping, *, water: bool) -> dict[str, Any]:
    """The keys that a scenario of vehicles needs and one of nodes leaves out."""
    count = len(nodes.entries)
    places = []
    for number, node in enumerate(nodes.entries.values()):
        place = node.entries.get("place") if isinstance(node, Mapping) else None
        bearing = 2 * pi * number / max(1, count)
        drawn = f"{_RADIUS_M * cos(bearing):.3f} {_RADIUS_M * sin(bearing):.3f} 0 m"
        places.append(place.value if isinstance(place, Scalar) and _is_place(place.value) else drawn)
    still = [{"position": place} for place in places]
    return {
        "vehicles": count,
        "duration": UNTIL_STOPPED,
        "tick": TICK_IN_WATER if water else TICK,
        "graph": {"shape": "complete", "reference": [1]},
        "network": {"period": _ROUND},
        "reference": {"start": "0 0 0 m", "velocity": "0 0 0 m/s"},
        "formation": {"offsets": places},
        "initial": still,
    }


def _is_place(value: Any) -> bool:
    """Whether it is a place; a wrong one is told where it was written alone."""
    try:
        vector(value, LENGTH)
    except QuantityError:
        return False
    return True


# Vehicles that do not move need no reference, and no tick within a round.
_MOORED = {
    "reference": {"start": "0 0 10 m", "velocity": "0 0 0 m/s"},
    "formation": {"shape": "line"},
    "initial": {"scatter": "0 m", "around": "reference"},
}
_ADDED = ("vehicles", "reference", "formation", "initial")


def _tree(value: Any, place: TextPlace) -> Node:
    if isinstance(value, dict):
        return Mapping({k: _tree(v, place) for k, v in value.items()}, dict.fromkeys(value, place), place)
    if isinstance(value, list):
        return Items(tuple(_tree(one, place) for one in value), place)
    return Scalar(value, place)
