"""Rules on the reference, the formation, the initial states and the graph."""

from __future__ import annotations

import math
from typing import Any

from agents.trajectory import Path, PathError
from fleet.quantities import show_time, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report, dotted_path, unknown_vehicle
from fleet.scenario.schema.motion import FORMATION, GRAPH, REFERENCE, FormationShape, ShapeKeys
from fleet.scenario.schema.spec import ScenarioSpec, sections
from fleet.scenario.sections.graph import parse_edge
from netem.condition import Link


def moored(parts: Parts, report: Report) -> None:
    """Moored vehicles have whole agents, and nothing that moves."""
    spec = parts.spec
    if not spec.moored:
        return
    if any(choice.whole_agent is None for _, choice in parts.choices()):
        hint = 'agent: "my_protocol:MyProtocol"; fleet new protocol NAME writes one'
        report.add(("moored",), "needs an agent for every vehicle, since there is nothing to steer", hint)
    for key in ("navigation", "keep_apart"):
        if report.has((key,)):
            report.add((key,), "has no effect on moored vehicles", key=True)
    for parent, section in sections(spec, "vehicle"):
        if section is not None and section.plant is not None:
            report.add((*parent, "vehicle", "plant"), "has no effect on moored vehicles", key=True)


Table = dict[str, ShapeKeys]


def reference(parts: Parts, report: Report) -> None:
    r = parts.spec.reference
    if not shape_keys(report, ("reference",), r, r.shape or "line", REFERENCE):
        return
    if r.shape == "lawn-mower" and r.leg is not None and r.spacing is not None and r.leg < r.spacing:
        text = f"a leg of {r.leg:g} m is shorter than the two arcs of {r.spacing / 2:g} m at its ends"
        report.add(("reference", "leg"), text, "make it at least the spacing")
        return
    path = parts.reference
    if isinstance(path, Path):
        try:
            path.length  # noqa: B018 - walks the path
        except PathError as error:
            where = f"leg {error.leg} " if error.leg else ""
            waypoints = r.points is not None
            hint = "lower speed or raise acceleration: the radius is speed^2 / acceleration"
            hint = hint if "arcs" in str(error) and waypoints else ""
            report.add(("reference", "points" if waypoints else "leg"), where + str(error), hint)


def shape_keys(report: Report, path: tuple[str | int, ...], section: Any, shape: str, known: Table) -> bool:
    """Check that the section has the keys that its shape needs, and no key of another shape."""
    keys = known[shape]
    fine = True
    for key in keys.needed:
        if getattr(section, key) is None:
            which = f", which shape {shape} needs" if section.shape else ""
            report.add_missing(path, key, which)
            fine = False
    for key in dict.fromkeys(key for other in known.values() for key in other.all):
        if getattr(section, key) is not None and key not in keys.all:
            others = " or ".join(name for name, other in known.items() if key in other.all)
            hint = f"for another shape replace the section, as in --set '{dotted_path(path)}={{shape: {shape}, ...}}'"
            report.add((*path, key), f"has no effect on {shape}: it belongs to {others}", hint, key=True)
            fine = False
    return fine


def formation(parts: Parts, report: Report) -> None:
    spec = parts.spec
    formation_shape(spec, report, ("formation",), spec.formation)
    end = 0
    for index, change in enumerate(spec.formation.changes or ()):
        path: tuple[str | int, ...] = ("formation", "changes", index)
        formation_shape(spec, report, path, change)
        if change.at < end:
            message = f"begins at {show_time(change.at)}, before the change before it is complete at {show_time(end)}"
            report.add((*path, "at"), message)
        end = change.at + change.over


def formation_shape(spec: ScenarioSpec, report: Report, path: tuple[str | int, ...], f: FormationShape) -> None:
    if f.offsets is None and f.shape is None:
        report.add(path, "needs offsets, one per vehicle, or a shape", key=True)
        return
    if f.offsets is not None and f.shape is not None:
        report.add((*path, "shape"), "either offsets or a shape, not both", key=True)
        return
    shape_keys(report, path, f, f.shape or "offsets", FORMATION)
    if f.offsets is not None:
        one_each(report, (*path, "offsets"), len(f.offsets), spec.vehicles)


def initial(parts: Parts, report: Report) -> None:
    spec = parts.spec
    states = spec.initial.vehicles
    if states is not None:
        one_each(report, ("initial",), len(states), spec.vehicles)
        for index, state in enumerate(states):
            if abs(state.pitch) >= math.pi / 2:
                got = f"got {math.degrees(state.pitch):g} deg"
                report.add(("initial", index, "pitch"), f"must be between -90 deg and 90 deg, {got}")


def one_each(report: Report, path: tuple[str | int, ...], got: int, vehicles: int) -> None:
    if got != vehicles:
        hint = "write one entry per vehicle"
        report.add(path, f"expected {vehicles} entries, one per vehicle, got {got}", hint, key=True)


def graph_form(parts: Parts, report: Report) -> None:
    spec = parts.spec
    g = spec.graph
    if g.edges is None and g.shape is None:
        report.add(("graph",), 'needs a shape, or edges such as {"1->2": 1.0}', key=True)
        return
    if g.edges is not None and g.shape is not None:
        report.add(("graph", "shape"), "either edges or a shape, not both", key=True)
        return
    shape_keys(report, ("graph",), g, g.shape or "edges", GRAPH)
    if g.shape == "ring" and spec.vehicles < 3:
        report.add(("graph", "shape"), f"a ring needs 3 vehicles or more, got {spec.vehicles}", "use path")
    if g.hub is not None and (wrong := unknown_vehicle(spec, g.hub)):
        report.add(("graph", "hub"), wrong)
    if g.count is not None and g.count >= spec.vehicles:
        message = f"a vehicle has {spec.vehicles - 1} others to hear, not {g.count}"
        report.add(("graph", "count"), message, "use complete for all of them")


def edges(parts: Parts, report: Report) -> None:
    spec = parts.spec
    seen: set[Link] = set()
    for text in report.keys("graph", "edges"):
        path = ("graph", "edges", text)
        link = parse_edge(text)
        if link is None:
            report.add(path, 'expected a directed edge such as "1->2": vehicle 2 hears vehicle 1', key=True)
            continue
        if link[0] == link[1]:
            report.add(path, "a vehicle cannot hear itself", key=True)
        if link in seen:
            report.add(path, "the same edge is given twice", key=True)
        seen.add(link)
        for wrong in filter(None, (unknown_vehicle(spec, end) for end in link)):
            report.add(path, wrong, key=True)


def followers(parts: Parts, report: Report) -> None:
    spec = parts.spec
    followers = spec.graph.reference
    if followers == "all":
        return
    if not followers:
        report.add(
            ("graph", "reference"),
            "no vehicle follows the reference (b_i > 0), so the formation would have no place to go",
            'write "all", or the numbers of the vehicles that do',
        )
    seen: set[int] = set()
    for index, number in enumerate(followers):
        if wrong := unknown_vehicle(spec, number):
            report.add(("graph", "reference", index), wrong)
        elif number in seen:
            report.add(("graph", "reference", index), f"vehicle {number} is given twice")
        seen.add(number)


def knowledge(parts: Parts, report: Report) -> None:
    """A vehicle on standby hears a vehicle that follows the reference.

    If it does not know the reference, it does not use it.
    """
    spec = parts.spec
    followers = set(range(1, spec.vehicles + 1) if spec.graph.reference == "all" else spec.graph.reference)
    standby = vehicle_numbers(spec.graph.standby.vehicles) if spec.graph.standby else []
    hear_one = {dst for src, dst in parts.links if src in followers} if standby else set()
    path = ("graph", "standby", "vehicles")
    for i in standby:
        if wrong := unknown_vehicle(spec, i):
            report.add(path, wrong)
        elif i in followers:
            report.add(path, f"vehicle {i} follows the reference itself (graph.reference)")
        elif i not in hear_one:
            text = f"vehicle {i} hears none of those that follow the reference, and so cannot tell when they are silent"
            report.add(path, text, "let it hear one of graph.reference, or choose another vehicle")
    for i in sorted(set(range(1, spec.vehicles + 1)) - followers - set(standby)):
        choice = parts.choice(parts.entries(i))
        assert choice.neighbours is not None
        knows = choice.knows_reference is not False
        if not knows and choice.neighbours.extrapolate == "reference" and choice.whole_agent is None:
            entries = tuple(n for n in spec.per_vehicle if i in vehicle_numbers(n))
            at = report.origin(entries, "neighbours", "extrapolate") or ("knows_reference",)
            text = f"vehicle {i} does not know the reference (knows_reference: false), so it cannot extrapolate by it"
            report.add(at, text, "use neighbours.extrapolate: neighbour, or hold")
            return
