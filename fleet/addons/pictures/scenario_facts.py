"""A report's text about a run's scenario: the fleet, its laws and its graph, and the conditions of its links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from agents.controllers import CONTROLLERS, laws
from fleet.addons.pictures.page import (
    Table,
)
from fleet.addons.pictures.runs import first_words
from fleet.quantities import vehicle_numbers
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.network import show_network
from fleet.scenario.sections.per_vehicle import Control

_NUMBERS = ("ahead", "behind", "weight", "hub", "count", "probability")  # of a graph's shape
_SHIPPED = {(pair.guidance, pair.tracking): name for name, pair in CONTROLLERS.items()}


def scenario_facts(scenario: Scenario) -> list[tuple[str, Any]]:
    """(name, value) of what one wants to know first."""
    of_vehicles = [
        ("vehicles", scenario.vehicles),
        ("graph", _graph(scenario)),
        ("controller", _words_by_vehicle([_laws(control) for control in scenario.controls])),
        ("profile", _words_by_vehicle(_profiles(scenario))),
    ]
    of_nodes = [("nodes", ", ".join(scenario.nodes)), ("carries", ", ".join(scenario.spec.carry or ["**"]))]
    return [
        ("scenario", scenario.name),
        *(of_nodes if scenario.nodes else of_vehicles),
        ("duration", f"{scenario.duration_ns / 1e9:g} s in ticks of {scenario.tick_ns / 1e6:g} ms"),
        ("seed", scenario.seed),
    ]


def network_facts(scenario: Scenario) -> list[tuple[str, Any]]:
    """(name, value) of the network: its rounds, and an acoustic channel's modem with what was changed of it."""
    if scenario.ideal:
        return [("network", "ideal: without latency")]
    network = show_network(scenario.spec.network)
    acoustic: dict[str, Any] = network.get("acoustic", {})
    return [
        ("network", "acoustic channel" if acoustic else "links"),
        ("round", f"every {network['period']}"),
        ("payload", network.get("payload", "full")),
        *((key.replace("_", " "), _words(value)) for key, value in acoustic.items()),
    ]


def conditions_table(scenario: Scenario) -> Table:
    """A row per selector of links, in the words of the scenario; no row where every link is perfect."""
    links = {} if scenario.ideal else show_network(scenario.spec.network).get("links", {})
    return Table(("links", "condition"), [(selector, _condition(shown)) for selector, shown in links.items()], "words")


def _condition(shown: Any) -> str:
    """The condition of links in words: one condition, states, or a trace (without its values, which are too many)."""
    if isinstance(shown, str):
        return shown
    states = [f"{name} (mean {state['mean']}): {state['condition']}" for name, state in shown.get("states", {}).items()]
    rest = {key: value for key, value in shown.items() if key not in ("states", "trace")}
    trace = [f"a trace of {shown['trace'].count(chr(10)) - 1} rows"] if "trace" in shown else []
    return "; ".join([*states, *trace, *([_words(rest)] if rest else [])])


def conditions_note(scenario: Scenario) -> str:
    """How the table of conditions is read, or why it has no row."""
    if scenario.ideal:
        return "What an agent sends is heard at the same tick."
    if not scenario.spec.network.links:
        return "" if scenario.acoustic else "Every link is perfect: what an agent sends is heard at the next tick."
    return "At the start. If several lines match a link, the last one applies; other links are ideal."


def _words(value: Any) -> Any:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(inner)}" for key, inner in value.items())
    return f"{value:g}" if isinstance(value, float) else value


def _graph(scenario: Scenario) -> str:
    section, links = scenario.spec.graph, scenario.graph.links
    given = section.model_dump(exclude_none=True, exclude_defaults=True)
    numbers = "".join(f", {key} {given[key]:g}" for key in _NUMBERS if key in given)
    shape = section.shape or f"edges {first_words([f'{src}->{dst}' for src, dst in links], 12)}"
    followers = [i for i, b in enumerate(scenario.b, start=1) if b]
    who = "every vehicle" if len(followers) == scenario.vehicles else _vehicles(followers)
    standby = section.standby
    ready = "" if standby is None else f", {_vehicles(vehicle_numbers(standby.vehicles))} on standby"
    return f"{shape}{numbers}; {len(links)} directed links; the reference is followed by {who}{ready}"


def _laws(control: Control) -> str:
    running = laws(control)
    if "guidance" not in running:
        return ", ".join(law.name for law in running.values())
    guidance, tracking = running["guidance"].name, running["tracking"].name
    name = _SHIPPED.get((guidance, tracking))
    pair = f"guidance {guidance}, tracking {tracking}"
    return pair if name is None else f"{name} ({pair})"


def _profiles(scenario: Scenario) -> list[str]:
    found: list[str] = [scenario.spec.profile] * scenario.vehicles
    for numbers, overrides in scenario.spec.per_vehicle.items():
        for i in vehicle_numbers(numbers):
            found[i - 1] = overrides.profile or found[i - 1]
    return found


def _words_by_vehicle(words: Sequence[str]) -> str:
    """A value for all vehicles, or with the vehicles that have it: `nboc`, `vehicles 1-3: nboc; vehicle 4: bc`."""
    which: dict[str, list[int]] = {}
    for i, text in enumerate(words, start=1):
        which.setdefault(text, []).append(i)
    if len(which) == 1:
        return words[0]
    return "; ".join(f"{_vehicles(numbers)}: {text}" for text, numbers in which.items())


def _vehicles(numbers: Sequence[int]) -> str:
    spans: list[list[int]] = []
    for number in numbers:
        if spans and spans[-1][-1] == number - 1:
            spans[-1].append(number)
        else:
            spans.append([number])
    text = first_words([str(s[0]) if len(s) == 1 else f"{s[0]}-{s[-1]}" for s in spans], 12)
    return f"vehicle{'' if len(numbers) == 1 else 's'} {text}"
