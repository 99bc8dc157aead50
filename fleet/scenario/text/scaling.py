"""A scenario for another number of vehicles than it was written for: what `--set vehicles=N` does to the tree.

Values that the file gives vehicle by vehicle do not fit another number of vehicles. They are replaced by values that
do:

| in the file | scaled |
|---|---|
| offsets of the formation | a grid |
| states at the start, one by one | a scatter, with the surge speed of the first |
| edges that form a chain | the same chain, longer or shorter |
| other edges | a path, in which neighbours hear each other |
| faults, changes of the formation, `expect` | nothing: they are written for the size of the fleet |
| links and vehicles that are gone, wherever they are named | nothing |

A shape scales by itself.
"""

from __future__ import annotations

import re
from itertools import zip_longest
from typing import Any

from fleet.quantities import QuantityError, vehicle_numbers
from fleet.scenario.schema.motion import DEFAULT_SPACING_M
from fleet.scenario.sections.graph import parse_edge
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, TextPlace, plain

# The tuning "paper" is fragile in its disturbance: 20 vehicles survive this start, at 1 m one of them tumbles,
# and of 100 vehicles one tumbles even so (seed 1). Undisturbed and hardened fleets of 100 survive.
_SCATTER_M = 0.5


def scale(before: Mapping, root: Mapping) -> Mapping:
    """The tree `root` made to fit its number of vehicles; `before` has the number that it was written for."""
    old, new = vehicle_count(before), vehicle_count(root)
    if new is None or old == new:
        return root
    made = {key: value for key, value in _loose(root).items() if key not in ("faults", "expect")}
    formation, initial, graph, network = (made.get(key) for key in ("formation", "initial", "graph", "network"))
    if isinstance(formation, dict):
        formation.pop("changes", None)
        if "offsets" in formation:
            made["formation"] = {"shape": "grid", "spacing": f"{DEFAULT_SPACING_M:g} m"}
    if isinstance(initial, list):
        first = initial[0] if initial and isinstance(initial[0], dict) else {}
        made["initial"] = {"scatter": f"{_SCATTER_M} m"} | {k: v for k, v in first.items() if k == "surge"}
    known = _scale_graph(graph, new) if isinstance(graph, dict) else new
    links = network.get("links") if isinstance(network, dict) else None
    for section, most in ((links, known), (made.get("per_vehicle"), new)):
        if isinstance(section, dict):
            for text in [text for text in section if any(n > most for n in _numbers(text))]:
                del section[text]
    if isinstance(checks := made.get("checks"), dict):
        made["checks"] = {name: check for name, check in checks.items() if _is_about_all(name, check)}
    scaled = _tight(made, root, root.keys["vehicles"])
    assert isinstance(scaled, Mapping)
    return scaled


def _loose(node: Node) -> Any:
    """A tree as dictionaries and lists, which can be changed; its scalars keep their places."""
    if isinstance(node, Mapping):
        return {key: _loose(value) for key, value in node.entries.items()}
    return [_loose(item) for item in node.items] if isinstance(node, Items) else node


def _tight(value: Any, before: Node | None, place: TextPlace) -> Node:
    """The tree of such values; what is new has `place`, what was there `before` its own."""
    if isinstance(value, dict):
        old = before if isinstance(before, Mapping) else Mapping({}, {}, place)
        entries = {key: _tight(inner, old.entries.get(key), place) for key, inner in value.items()}
        return Mapping(entries, {key: old.keys.get(key, place) for key in value}, old.place)
    if isinstance(value, list):
        items = before.items if isinstance(before, Items) else ()
        both = zip_longest(value, items[: len(value)])
        return Items(tuple(_tight(inner, old, place) for inner, old in both), place if before is None else before.place)
    return value if isinstance(value, Scalar) else Scalar(value, place)


def vehicle_count(root: Mapping) -> int | None:
    """The number of vehicles that a tree gives; None for anything but a positive whole number."""
    value = plain(root.entries["vehicles"]) if "vehicles" in root.entries else None
    return value if type(value) is int and value > 0 else None


def _scale_graph(graph: dict[str, Any], vehicles: int) -> int:
    """Make a graph fit; returns the highest number of a vehicle whose links are as they were."""
    edges = graph.pop("edges", None)
    chain = _longer_chain(edges, vehicles) if isinstance(edges, dict) else None
    if chain is not None:
        graph["edges"] = chain
    elif edges is not None:
        graph["shape"] = "path"
    for key, most in (("hub", vehicles), ("count", vehicles - 1)):
        if _is_above(graph.get(key), most):
            del graph[key]
    standby = graph.get("standby")
    who = standby.get("vehicles") if isinstance(standby, dict) else None
    if isinstance(who, Scalar) and any(n > vehicles for n in _numbers(str(who.value))):
        del graph["standby"]
    followers = graph.get("reference")
    if isinstance(followers, Scalar) and followers.value != "all":
        followers = _list_vehicles(followers)
    if isinstance(followers, list):
        graph["reference"] = [n for n in followers if not _is_above(n, vehicles)]
    return vehicles if edges is None or chain is not None else 0


def _is_about_all(name: str, check: Any) -> bool:
    """Whether a check is not one of some vehicles, of some links or of a fault."""
    keys = check if isinstance(check, dict) else {}
    links = keys.get("links")
    some_links = isinstance(links, Scalar) and bool(_numbers(str(links.value)))
    return not (name == "recovery_time" or some_links or "vehicles" in keys)


def _longer_chain(edges: dict[str, Any], vehicles: int) -> dict[str, Any] | None:
    """The chain 1->2, 2->3, ... or 2->1, 3->2, ... of all vehicles, if these edges are one; else None.

    A link that is new has the weight of the last one.
    """
    weights = {parse_edge(text): weight for text, weight in edges.items()}
    for ahead, behind in ((0, 1), (1, 0)):
        links = [(k + ahead, k + behind) for k in range(1, max(vehicles, len(weights) + 1))]
        if weights and set(weights) == set(links[: len(weights)]):
            last = weights[links[len(weights) - 1]]
            return {f"{src}->{dst}": weights.get((src, dst), last) for src, dst in links[: vehicles - 1]}
    return None


def _list_vehicles(named: Scalar) -> Scalar | list[Scalar]:
    """Vehicles such as `2-4, 7` one by one; a text that names none stays, and becomes an error when it is read."""
    try:
        return [Scalar(n, named.place) for n in vehicle_numbers(str(named.value))]
    except QuantityError:
        return named


def _is_above(node: Any, most: int) -> bool:
    return isinstance(node, Scalar) and type(node.value) is int and node.value > most


def _numbers(selector: str) -> list[int]:
    return [int(n) for n in re.findall(r"\d{1,9}", selector, re.ASCII)]
