"""What rules see of a scenario: who runs which law, who hears whom, where each is to be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from agents.offset import Offset
from agents.trajectory import PathError
from fleet.quantities import Vec3, vehicle_numbers
from fleet.scenario.rules.report import Entries, UnknownValueError
from fleet.scenario.schema.control import GuidanceSection, VehicleOverrides
from fleet.scenario.schema.shapes import REFERENCE
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.formation import plans
from fleet.scenario.sections.graph import build, parse_edge
from fleet.scenario.sections.per_vehicle import law_names, merged
from fleet.scenario.sections.reference import build as build_reference
from netem.condition import Link

_BLEND_SAMPLES = 40


def layers(spec: ScenarioSpec, key: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(path, section) of a section wherever it is given: for all vehicles, and for some."""
    yield (), getattr(spec, key)
    for numbers, overrides in spec.per_vehicle.items():
        if getattr(overrides, key) is not None:
            yield ("per_vehicle", numbers), getattr(overrides, key)


def choices(spec: ScenarioSpec) -> Iterator[tuple[Entries, VehicleOverrides]]:
    """(entries, what holds), once for all vehicles that the same entries name; first without any entry."""
    yield (), merged(spec, 0)
    named = {numbers: set(vehicle_numbers(numbers)) for numbers in spec.per_vehicle}
    alike = {tuple(n for n, vehicles in named.items() if i in vehicles): i for i in range(1, spec.vehicles + 1)}
    yield from ((entries, merged(spec, i)) for entries, i in alike.items() if entries)


def guidance(spec: ScenarioSpec) -> Iterator[tuple[Entries, str, GuidanceSection, str]]:
    """(entries, law, section, profile) for all vehicles alike, where a guidance law runs."""
    for entries, choice in choices(spec):
        names = law_names(choice)
        if names is not None:
            assert choice.guidance is not None and choice.profile is not None
            yield entries, names[0], choice.guidance, choice.profile


def graph_links(spec: ScenarioSpec) -> tuple[Link, ...]:
    g = spec.graph
    if (g.edges is None) == (g.shape is None) or any(parse_edge(text) is None for text in g.edges or ()):
        raise UnknownValueError
    if g.shape == "nearest":
        places = tuple(plan.start for plan in offset_plans(spec))
    else:
        places = ((0.0, 0.0, 0.0),) * spec.vehicles
    return build(g, places, spec.seed if g.shape == "random" else 0).links


def key_of(entries: Entries, key: str) -> str:
    """The nearest key that sets a guidance parameter of the vehicles that these entries name."""
    return f"per_vehicle.{entries[-1]}.guidance.{key}" if entries else f"guidance.{key}"


def desired_velocity(spec: ScenarioSpec) -> tuple[Vec3, Vec3]:
    """Least and greatest velocity that any vehicle is asked for on each axis, changes of the formation included."""
    r = spec.reference
    needed = REFERENCE[r.shape or "line"].needed
    if any(getattr(r, key) is None for key in needed):
        raise UnknownValueError
    reference = build_reference(r)
    try:
        low, high = map(list, reference.velocity_bounds())
    except PathError:
        raise UnknownValueError from None
    for change in spec.formation.changes or ():
        for step in range(_BLEND_SAMPLES + 1):
            t = (change.at + change.over * step / _BLEND_SAMPLES) / 1e9
            velocity = reference.at(t).velocity
            for plan in offset_plans(spec):
                rate = plan.at(t).velocity
                for axis in range(3):
                    low[axis] = min(low[axis], velocity[axis] + rate[axis])
                    high[axis] = max(high[axis], velocity[axis] + rate[axis])
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def offset_plans(spec: ScenarioSpec) -> tuple[Offset, ...]:
    shapes = [spec.formation, *(spec.formation.changes or ())]
    if any((f.offsets is None) == (f.shape is None) for f in shapes):
        raise UnknownValueError
    if any(f.offsets is not None and len(f.offsets) != spec.vehicles for f in shapes):
        raise UnknownValueError
    return plans(spec.formation, spec.vehicles)
