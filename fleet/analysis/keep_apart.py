"""Limits of the section `keep_apart` in a scenario, as warnings before a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import dist

from fleet.quantities import vehicle_names
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.keep_apart import KeepApartSection
from world.vectors import Vec3, plus


def keep_apart_warnings(scenario: Scenario) -> Iterator[str]:
    """One sentence for each; none without the section."""
    section = scenario.spec.keep_apart
    if section is None:
        return
    controls = list(enumerate(scenario.controls, start=1))
    agents = [i for i, control in controls if control.agent is not None]
    if agents:
        yield (
            f"keep_apart acts only within a FormationAgent: if the agent of {vehicle_names(agents)} has none, or "
            "commands the vehicle by itself, this vehicle does not keep apart, and the others do their half only"
        )
    without = [i for i, control in controls if control.agent is None and control.controller is not None]
    if without:
        yield (
            f"keep_apart acts between guidance and tracking: {vehicle_names(without)} with a law in place of both "
            f"{'does' if len(without) == 1 else 'do'} not keep apart, and the others do their half only"
        )
    links = set(scenario.graph.links)
    pairs = combinations(range(1, scenario.vehicles + 1), 2)
    deaf = [(i, j) for i, j in pairs if (i, j) not in links or (j, i) not in links]
    if deaf:
        more = f", and {len(deaf) - 1} more pairs like them" if len(deaf) > 1 else ""
        yield (
            f"keep_apart: vehicles {deaf[0][0]} and {deaf[0][1]} do not both hear each other{more}; a vehicle keeps "
            "apart from those that it hears, so add links to the graph"
        )
    steepest = max(abs(_climb(scenario, t)) for t in range(scenario.duration_ns // 1_000_000_000 + 1))
    if steepest > section.climb:
        yield (
            f"keep_apart: the course of a vehicle climbs or dives with up to {steepest:.3g} m/s, but keep_apart.climb "
            f"limits every command to {section.climb:g} m/s, so the vehicle falls behind"
        )
    yield from _too_near("at the start", [eta[:3] for eta, _ in scenario.initial], section)
    end = scenario.duration_ns / 1e9
    place = scenario.reference.at(end).position
    there = [plan.at(end).position for plan in scenario.plans]
    yield from _too_near("in the formation at the end", [plus(place, offset) for offset in there], section)


def _climb(scenario: Scenario, t: float) -> float:
    """The fastest climb or dive that any vehicle is to make at a time [s], downwards positive [m/s]."""
    down = scenario.reference.at(t).velocity[2]
    return max((down + plan.at(t).velocity[2] for plan in scenario.plans), key=abs)


def _too_near(when: str, places: Sequence[Vec3], section: KeepApartSection) -> Iterator[str]:
    numbered = list(enumerate(places, start=1))
    pairs = [(dist(p, q), i, j) for (i, p), (j, q) in combinations(numbered, 2)]
    nearest = min(pairs, default=None)
    if nearest is not None and nearest[0] < section.distance:
        yield (
            f"keep_apart: {when} vehicles {nearest[1]} and {nearest[2]} are {nearest[0]:.4g} m apart, but "
            f"keep_apart.distance is {section.distance:g} m"
        )
    for number, obstacle in enumerate(section.obstacles, start=1):
        inside = [i for i, (north, east, _) in numbered if dist((north, east), obstacle.at) < obstacle.radius]
        if inside:
            verb = "is" if len(inside) == 1 else "are"
            yield f"keep_apart: {when} {vehicle_names(inside)} {verb} within obstacle {number}"
