"""What a scenario's keys must fulfil together.

Each rule looks at a few keys and reports what does not fit. A rule that reads a key which is wrong by itself,
and so is reported already, stops there (`UnknownValueError`) and the other rules go on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.config import Law
from agents.controllers import BUILT_IN, CONTROLLERS
from agents.errors import PluginError, UntrustedError
from agents.offset import Offset
from agents.plugins.loading import load
from agents.profiles import profile
from agents.trajectory import Path as Path_
from agents.trajectory import PathError
from fleet.errors import Problem
from fleet.quantities import RATE, SPEED, QuantityError, Vec3, show, show_time, show_vector, vehicle_numbers
from fleet.recorder.snapshot import snapshot_grid
from fleet.scenario.schema.shapes import FORMATION, GRAPH, REFERENCE, Keys
from fleet.scenario.schema.spec import (
    EVERY,
    FaultAction,
    FormationShape,
    GuidanceSection,
    ScenarioSpec,
    VehicleOverrides,
)
from fleet.scenario.sections import acoustic
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.formation import plans
from fleet.scenario.sections.graph import build, parse_edge
from fleet.scenario.sections.nemesis import count as nemesis_faults
from fleet.scenario.sections.nemesis import unleash
from fleet.scenario.sections.partitions import FaultError, partition
from fleet.scenario.sections.per_vehicle import given, law_names, merged, qp_period_ns, used, vehicle, wrong_model
from fleet.scenario.sections.reference import build as build_reference
from fleet.scenario.sections.timeline import ACTIONS, OF_THE_WORLD, action, does_nothing, vehicles_of
from fleet.scenario.sections.timeline import plan as fault_plan
from fleet.scenario.sections.vehicle_files import VehicleFileError, mass_problems
from fleet.scenario.text.yaml_reader import Mapping, locate
from fleet.scenario.trust import READING, Policy
from netem.condition import Link
from netem.parsing import GrammarError, nearest
from netem.selectors import parse_selector, select

Table = dict[str, Keys]
Entries = tuple[str, ...]  # the keys of per_vehicle that name a vehicle
_LINKS_SHOWN = 12
_BLEND_SAMPLES = 40
MOST_FAULTS = 5000  # of one scenario, those of its nemesis included: each is looked at in every tick
MOST_TARGETS = 100_000  # faults times vehicles: each may be about all of them


def _dotted(path: tuple[str | int, ...]) -> str:
    return ".".join(str(step + 1) if isinstance(step, int) else step for step in path)


class UnknownValueError(Exception):
    """The value that a rule needs is itself wrong."""


@dataclass
class Report:
    """The problems found so far in one tree."""

    root: Mapping
    folder: Path | None = None  # where the scenario's file lies
    problems: list[Problem] = field(default_factory=list)
    policy: Policy = READING
    _added: set[Problem] = field(default_factory=set)

    def add(self, path: tuple[str | int, ...], message: str, hint: str = "", *, key: bool = False) -> None:
        """Report a mistake, once, at the value (or the key) at `path`, or at its nearest ancestor that is there."""
        path = self._written(path)
        problem = locate(self.root, path, key=key).problem(f"{_dotted(path)}: {message}", hint)
        if problem not in self._added:
            self._added.add(problem)
            self.problems.append(problem)

    def refuse(self, path: tuple[str | int, ...], message: str, hint: str) -> None:
        """Report a law that may not run."""
        if self.policy.refused is None:
            self.add(path, message, hint)
        else:
            place = locate(self.root, self._written(path))
            self.policy.refused.append(place.problem(f"{_dotted(path)}: {message}", hint))

    def typed(self, path: tuple[str | int, ...]) -> bool:
        """Whether the value at `path` was given on the command line."""
        return locate(self.root, self._written(path)).source.rank > 0

    def add_missing(self, path: tuple[str | int, ...], key: str, why: str) -> None:
        """Report a key that a section should have."""
        place = locate(self.root, path, key=True)
        self.problems.append(place.problem(f'"{key}" is missing in "{_dotted(path)}"{why}'))

    def has(self, path: tuple[str, ...]) -> bool:
        """Whether the file says anything at `path`."""
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
        """Where a value was written that holds for vehicles: in the last of their entries that has it, or for all."""
        places = [*(("per_vehicle", numbers, *path) for numbers in reversed(entries)), path]
        return next((place for place in places if self.has(place)), None)

    def _written(self, path: tuple[Any, ...]) -> tuple[Any, ...]:
        """`path` with the spaces that its vehicle numbers have in the file."""
        if len(path) < 2 or path[0] != "per_vehicle" or path[1] in self.keys("per_vehicle"):
            return path
        text = next((text for text in self.keys("per_vehicle") if _packed(text) == path[1]), path[1])
        return (path[0], text, *path[2:])


def _packed(numbers: str) -> str:
    """Vehicle numbers as the schema keeps them."""
    return "".join(numbers.split())


def check(spec: ScenarioSpec, report: Report) -> None:
    """Apply every rule."""
    for rule in RULES:
        try:
            rule(spec, report)
        except UnknownValueError:
            continue


def _duration(spec: ScenarioSpec, report: Report) -> None:
    _whole(report, ("duration",), spec.duration, spec.tick)


def _network_period(spec: ScenarioSpec, report: Report) -> None:
    if not spec.network.ideal:
        _whole(report, ("network", "period"), spec.network.period, spec.tick)


def _qp_period(spec: ScenarioSpec, report: Report) -> None:
    for entries, law, section, name in _guidance(spec):
        period = qp_period_ns(name, section)
        if "qp_period" not in used("guidance", law) or period % spec.tick == 0:
            continue
        path = report.origin(entries, "guidance", "qp_period")
        if path is not None:
            _whole(report, path, period, spec.tick)
        else:
            report.add(
                ("tick",),
                f"the QP period of profile {name}, {show_time(period)}, is not a whole number of ticks "
                f"of {show_time(spec.tick)}",
                "choose a tick that divides it, or set guidance.qp_period",
            )


def _layers(spec: ScenarioSpec, key: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(path, section) of a section wherever it is given: for all vehicles, and for some."""
    yield (), getattr(spec, key)
    for numbers, overrides in spec.per_vehicle.items():
        if getattr(overrides, key) is not None:
            yield ("per_vehicle", numbers), getattr(overrides, key)


def _choices(spec: ScenarioSpec) -> Iterator[tuple[Entries, VehicleOverrides]]:
    """(entries, what holds), once for all vehicles that the same entries name; first without any entry."""
    yield (), merged(spec, 0)
    named = {numbers: set(vehicle_numbers(numbers)) for numbers in spec.per_vehicle}
    alike = {tuple(n for n, vehicles in named.items() if i in vehicles): i for i in range(1, spec.vehicles + 1)}
    yield from ((entries, merged(spec, i)) for entries, i in alike.items() if entries)


def _guidance(spec: ScenarioSpec) -> Iterator[tuple[Entries, str, GuidanceSection, str]]:
    """(entries, law, section, profile) for all vehicles alike, where a guidance law runs."""
    for entries, choice in _choices(spec):
        names = law_names(choice)
        if names is not None:
            assert choice.guidance is not None and choice.profile is not None
            yield entries, names[0], choice.guidance, choice.profile


def _policies(spec: ScenarioSpec, report: Report) -> None:
    if spec.network.ideal and spec.on_controller_error == "die":
        message = "the others of an ideal network wait for everybody, also for an agent that is gone"
        report.add(("on_controller_error",), message, "abort, coast, or give the network a period")
    for path, external in _layers(spec, "external"):
        if external and spec.network.ideal:
            message = "nobody can join an ideal network, which runs in one process"
            report.add((*path, "external"), message, "give the network a period")


def _snapshot(spec: ScenarioSpec, report: Report) -> None:
    if spec.log.snapshot:
        every = snapshot_grid(spec)
        if spec.log.snapshot % (every * spec.tick):
            message = f"{show_time(spec.log.snapshot)} is no multiple of {show_time(every * spec.tick)}"
            report.add(("log", "snapshot"), message, "a snapshot is taken at a round whose frame is logged")


def _whole(report: Report, path: tuple[str | int, ...], ns: int, tick: int) -> None:
    if ns % tick:
        below = ns // tick * tick
        near = " or ".join(show_time(t) for t in (below, below + tick) if t)
        message = f"{show_time(ns)} is not a whole number of ticks of {show_time(tick)}"
        report.add(path, message, f"nearest: {near}")


def _reference(spec: ScenarioSpec, report: Report) -> None:
    r = spec.reference
    if not _shape_keys(report, ("reference",), r, r.shape or "line", REFERENCE):
        return
    if r.shape == "lawn-mower" and r.leg is not None and r.spacing is not None and r.leg < r.spacing:
        text = f"a leg of {r.leg:g} m is shorter than the two arcs of {r.spacing / 2:g} m at its ends"
        report.add(("reference", "leg"), text, "make it at least the spacing")
        return
    path = build_reference(r)
    if isinstance(path, Path_):
        try:
            path.length  # noqa: B018 - walks the path
        except PathError as error:
            where = f"leg {error.leg} " if error.leg else ""
            waypoints = r.points is not None
            hint = "lower speed or raise acceleration: the radius is speed^2 / acceleration"
            hint = hint if "arcs" in str(error) and waypoints else ""
            report.add(("reference", "points" if waypoints else "leg"), where + str(error), hint)


def _shape_keys(report: Report, path: tuple[str | int, ...], section: Any, shape: str, known: Table) -> bool:
    """Whether the section has what its shape needs, and nothing that belongs to another shape."""
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
            hint = f"for another shape replace the section, as in --set '{_dotted(path)}={{shape: {shape}, ...}}'"
            report.add((*path, key), f"has no effect on {shape}: it belongs to {others}", hint, key=True)
            fine = False
    return fine


def _formation(spec: ScenarioSpec, report: Report) -> None:
    _formation_shape(spec, report, ("formation",), spec.formation)
    end = 0
    for index, change in enumerate(spec.formation.changes or ()):
        path: tuple[str | int, ...] = ("formation", "changes", index)
        _formation_shape(spec, report, path, change)
        if change.at < end:
            message = f"begins at {show_time(change.at)}, before the change before it is complete at {show_time(end)}"
            report.add((*path, "at"), message)
        end = change.at + change.over


def _formation_shape(spec: ScenarioSpec, report: Report, path: tuple[str | int, ...], f: FormationShape) -> None:
    if f.offsets is None and f.shape is None:
        report.add(path, "needs offsets, one per vehicle, or a shape", key=True)
        return
    if f.offsets is not None and f.shape is not None:
        report.add((*path, "shape"), "either offsets or a shape, not both", key=True)
        return
    _shape_keys(report, path, f, f.shape or "offsets", FORMATION)
    if f.offsets is not None:
        _one_each(report, (*path, "offsets"), len(f.offsets), spec.vehicles)


def _initial(spec: ScenarioSpec, report: Report) -> None:
    states = spec.initial.vehicles
    if states is not None:
        _one_each(report, ("initial",), len(states), spec.vehicles)
        for index, state in enumerate(states):
            if abs(state.pitch) >= math.pi / 2:
                report.add(("initial", index, "pitch"), "must be between -90 deg and 90 deg")


def _one_each(report: Report, path: tuple[str | int, ...], got: int, vehicles: int) -> None:
    if got != vehicles:
        hint = "write one entry per vehicle"
        report.add(path, f"expected {vehicles} entries, one per vehicle, got {got}", hint, key=True)


def _graph_form(spec: ScenarioSpec, report: Report) -> None:
    g = spec.graph
    if g.edges is None and g.shape is None:
        report.add(("graph",), 'needs a shape, or edges such as {"1->2": 1.0}', key=True)
        return
    if g.edges is not None and g.shape is not None:
        report.add(("graph", "shape"), "either edges or a shape, not both", key=True)
        return
    _shape_keys(report, ("graph",), g, g.shape or "edges", GRAPH)
    if g.shape == "ring" and spec.vehicles < 3:
        report.add(("graph", "shape"), f"a ring needs 3 vehicles or more, got {spec.vehicles}", "use path")
    if g.hub is not None and g.hub > spec.vehicles:
        report.add(("graph", "hub"), f"there is no vehicle {g.hub}: they are 1 to {spec.vehicles}")
    if g.count is not None and g.count >= spec.vehicles:
        message = f"a vehicle has {spec.vehicles - 1} others to hear, not {g.count}"
        report.add(("graph", "count"), message, "use complete for all of them")


def _edges(spec: ScenarioSpec, report: Report) -> None:
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
        for end in link:
            if not 1 <= end <= spec.vehicles:
                report.add(path, f"there is no vehicle {end}: they are 1 to {spec.vehicles}", key=True)


def _followers(spec: ScenarioSpec, report: Report) -> None:
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
        if not 1 <= number <= spec.vehicles:
            report.add(("graph", "reference", index), f"there is no vehicle {number}: they are 1 to {spec.vehicles}")
        elif number in seen:
            report.add(("graph", "reference", index), f"vehicle {number} is given twice")
        seen.add(number)


def _knowledge(spec: ScenarioSpec, report: Report) -> None:
    """Who follows the reference or stands by to must hear whom it stands by for; who does not know it cannot use it."""
    followers = set(range(1, spec.vehicles + 1) if spec.graph.reference == "all" else spec.graph.reference)
    standby = vehicle_numbers(spec.graph.standby.vehicles) if spec.graph.standby else []
    hear_one = {dst for src, dst in _graph_links(spec) if src in followers} if standby else set()
    path = ("graph", "standby", "vehicles")
    for i in standby:
        if not 1 <= i <= spec.vehicles:
            report.add(path, f"there is no vehicle {i}: they are 1 to {spec.vehicles}")
        elif i in followers:
            report.add(path, f"vehicle {i} follows the reference itself (graph.reference)")
        elif i not in hear_one:
            text = f"vehicle {i} hears none of those that follow the reference, and so cannot tell when they are silent"
            report.add(path, text, "let it hear one of graph.reference, or choose another vehicle")
    for i in sorted(set(range(1, spec.vehicles + 1)) - followers - set(standby)):
        choice = merged(spec, i)
        assert choice.neighbours is not None
        told = choice.knows_reference is not False
        if not told and choice.neighbours.extrapolate == "reference" and choice.agent is None:
            entries = tuple(n for n in spec.per_vehicle if i in vehicle_numbers(n))
            at = report.origin(entries, "neighbours", "extrapolate") or ("knows_reference",)
            text = f"vehicle {i} does not know the reference (knows_reference: false), so it cannot extrapolate by it"
            report.add(at, text, "use neighbours.extrapolate: neighbour, or hold")
            return


def _links(spec: ScenarioSpec, report: Report) -> None:
    written: dict[str, str] = {}
    links = _graph_links(spec)
    known: set[tuple[int | None, int | None]] = {(None, None), *links}
    known |= {(src, None) for src, _ in links} | {(None, dst) for _, dst in links}
    for text in report.keys("network", "links"):
        path = ("network", "links", text)
        try:
            selector = parse_selector(text)
        except GrammarError:
            continue  # reported by the schema
        if str(selector) in written:
            report.add(path, f'the same links as "{written[str(selector)]}"', key=True)
        written[str(selector)] = text
        # (None, None), "*", is every link there is, even if that is none: a fleet of one keeps its scenario.
        there = (selector.src, selector.dst) in known
        if not there and not (selector.both and (selector.dst, selector.src) in known):
            shown = ", ".join(f"{src}->{dst}" for src, dst in links[:_LINKS_SHOWN])
            more = f" and {len(links) - _LINKS_SHOWN} more" if len(links) > _LINKS_SHOWN else ""
            report.add(path, "the graph has no such link", f"links: {shown}{more}", key=True)


def _acoustic(spec: ScenarioSpec, report: Report) -> None:
    """The modem, and what belongs to the way in which turns are taken."""
    section = spec.network.acoustic
    if section is None:
        return
    at = ("network", "acoustic")
    others = {"aloha": ("slot", "guard"), "tdma": ("backoff",)}
    for key in others[section.mac]:
        if getattr(section, key) is not None:
            other = "tdma" if section.mac == "aloha" else "aloha"
            report.add((*at, key), f"has no effect on mac {section.mac}: it belongs to {other}", key=True)
    if section.mac == "tdma" and section.slot is None:
        report.add_missing(at, "slot", ", which mac tdma needs")
    for key in ("slot", "backoff"):
        if getattr(section, key):
            _whole(report, (*at, key), getattr(section, key), spec.tick)
    if section.water is not None:
        if section.sound_speed is not None:
            report.add((*at, "sound_speed"), "either a speed or the water that it follows from, not both", key=True)
        for key, low, high, unit in (
            ("temperature", 2, 30, "degC"),
            ("salinity", 25, 40, "ppt"),
            ("depth", 0, 8000, "m"),
        ):
            value = getattr(section.water, key)
            if not low <= value <= high:
                text = f"{value:g} {unit} is outside {low} to {high} {unit}, for which the formula was made"
                report.add((*at, "water", key), text, "give sound_speed instead")
    if section.sound_speed is not None and not 100.0 <= section.sound_speed <= 10_000.0:
        report.add((*at, "sound_speed"), f"must be between 100 and 10000 m/s, is {section.sound_speed:g}")
    if section.wind > 100.0:
        report.add((*at, "wind"), f"must be at most 100 m/s, is {section.wind:g}")
    try:
        wrong = acoustic.problems(section, report.folder)
    except DataFileError as error:
        wrong = error.problems
    for problem in wrong:
        report.add((*at, "modem"), problem)


def _talking(spec: ScenarioSpec, report: Report) -> None:
    """What our agents say fits into a packet, and into a slot with its guard, which sound crosses the fleet in."""
    section = spec.network.acoustic
    if section is None:
        return
    at = ("network", "acoustic")
    try:
        if acoustic.problems(section, report.folder):
            return
        modem = acoustic.modem(section, report.folder)
    except DataFileError:
        return  # reported already
    codec, size = spec.network.payload, acoustic.SIZES[spec.network.payload]
    ours = any(choice.agent is None for _, choice in _choices(spec))
    if ours and size > modem.mtu:
        compact = acoustic.SIZES["compact"]
        hint = f"network.payload: compact has {compact} bytes" if codec == "full" and compact <= modem.mtu else ""
        report.add(
            (*at, "modem"), f"the {codec} payload of {size} bytes is longer than its mtu, {modem.mtu} bytes", hint
        )
        return
    if section.mac != "tdma" or section.slot is None:
        return
    airtime, guard = modem.airtime_ns(size) if ours else modem.airtime_ns(0), acoustic.guard_ns(section)
    if airtime + guard > section.slot:
        text = (
            f"{show_time(section.slot)} are too short: {size} bytes are {airtime / 1e9:g} s on the air, "
            f"and the guard is {show_time(guard)}"
        )
        report.add((*at, "slot"), text, f"at least {(airtime + guard) / 1e9:g} s")
    extent = acoustic.extent_m(_plans(spec))
    crossing = extent / acoustic.speed_of_sound(section)
    if crossing * 1e9 > guard:
        text = (
            f"{show_time(guard)} are too short: sound takes {crossing:.4g} s over the {extent:.4g} m of the formation"
        )
        report.add((*at, "guard" if section.guard is not None else "slot"), text, "a longer guard")


def _graph_links(spec: ScenarioSpec) -> tuple[Link, ...]:
    g = spec.graph
    if (g.edges is None) == (g.shape is None) or any(parse_edge(text) is None for text in g.edges or ()):
        raise UnknownValueError
    if g.shape == "nearest":
        places = tuple(plan.start for plan in _plans(spec))
    else:
        places = ((0.0, 0.0, 0.0),) * spec.vehicles
    return build(g, places, spec.seed if g.shape == "random" else 0).links


def _checks(spec: ScenarioSpec, report: Report) -> None:
    for name in ("formation_error", "consensus_error", "min_separation", "connected", "tumbled"):
        check = getattr(spec.checks, name)
        if check is not None and check.vehicles:
            _vehicles_exist(spec, report, ("checks", name, "vehicles"), check.vehicles)
    separation = spec.checks.min_separation
    if separation is not None and separation.vehicles and len(set(vehicle_numbers(separation.vehicles))) < 2:
        report.add(("checks", "min_separation", "vehicles"), "a distance is between two vehicles or more")


def _vehicles_exist(spec: ScenarioSpec, report: Report, path: tuple[str | int, ...], text: str) -> None:
    for number in vehicle_numbers(text):
        if not 1 <= number <= spec.vehicles:
            report.add(path, f"there is no vehicle {number}: they are 1 to {spec.vehicles}")
            break


def _max_age(spec: ScenarioSpec, report: Report) -> None:
    check = spec.checks.max_age
    if check is None:
        return
    if not spec.network.ideal and check.below <= spec.network.period:
        report.add(
            ("checks", "max_age", "below"),
            f"every age grows to a round of {show_time(spec.network.period)} before the next can be heard",
            "choose more",
        )
    if check.links != "*" and not select(parse_selector(check.links), _graph_links(spec)):
        report.add(("checks", "max_age", "links"), f"the graph has no link {check.links}")


def _connected(spec: ScenarioSpec, report: Report) -> None:
    check = spec.checks.connected
    if check is None:
        return
    path = ("checks", "connected", "window")
    _whole(report, path, check.window, spec.tick)
    if not spec.network.ideal and check.window < spec.network.period:
        message = f"is shorter than a round of {show_time(spec.network.period)}: nothing is sent in some windows"
        report.add(path, message, "choose several rounds")


def _recovery_time(spec: ScenarioSpec, report: Report) -> None:
    checks = spec.checks.recovery_time
    if not checks:
        return
    if any(problem.message.startswith(("faults", "nemesis")) for problem in report.problems):
        raise UnknownValueError  # there is no timeline yet
    spec = unleash(spec, _graph_links(spec))
    known, lasting = _fault_names(spec)
    one = bool(report.keys("checks", "recovery_time"))  # given without the list
    for index, check in enumerate(checks):
        path: tuple[str | int, ...] = ("checks", "recovery_time", *(() if one else (index,)))
        if check.fault == EVERY:
            if EVERY in known:
                message = f'"{EVERY}" means each fault, and a fault is called so'
                report.add((*path, "fault"), message, "give that fault another id")
        elif check.fault not in known:
            shown = f"known: {', '.join([*known[:_LINKS_SHOWN], EVERY])}" if known else "the scenario has none"
            more = f" and {len(known) - _LINKS_SHOWN} more" if len(known) > _LINKS_SHOWN else ""
            report.add((*path, "fault"), f'there is no fault "{check.fault[:40]}"', shown + more)
        elif check.fault in lasting:
            message = f'"{check.fault}" lasts to the end of the run: nothing can recover from it'
            report.add((*path, "fault"), message, 'give the fault a "for"')
        if check.vehicles:
            _vehicles_exist(spec, report, (*path, "vehicles"), check.vehicles)


def _fault_names(spec: ScenarioSpec) -> tuple[list[str], set[str]]:
    """The ids of all faults in their order, and those of which nothing says that they end before the run."""
    events = fault_plan(spec, _graph_links(spec)).events
    last = spec.duration // spec.tick
    ending = {event.fault for event in events if event.action == "ends" and event.tick < last}
    written = {fault.id or f"f{n}": fault for n, fault in enumerate(spec.faults, start=1)}
    lasting = {name for name, fault in written.items() if fault.for_ is None and name not in ending}
    return list(dict.fromkeys([*written, *(event.fault for event in events)])), lasting


def _faults(spec: ScenarioSpec, report: Report) -> None:
    if len(spec.faults) > (most := _most_faults(spec)):
        report.add(("faults",), f"{len(spec.faults)} faults, expected at most {most}")
        return
    links = _graph_links(spec)
    seen: dict[str, int] = {}
    for index, fault in enumerate(spec.faults):
        path: tuple[str | int, ...] = ("faults", index)
        if not _one_action(fault, path, report):
            continue
        name = fault.id or f"f{index + 1}"
        if name in seen:
            report.add((*path, "id"), f'fault {seen[name] + 1} is called "{name}" as well')
        seen[name] = index
        _whole(report, (*path, "at"), fault.at, spec.tick)
        if fault.for_ is not None:
            _whole(report, (*path, "for"), fault.for_, spec.tick)
        _fault_targets(spec, report, path, fault, links)


def _most_faults(spec: ScenarioSpec) -> int:
    return min(MOST_FAULTS, MOST_TARGETS // spec.vehicles)


def _nemesis(spec: ScenarioSpec, report: Report) -> None:
    nemesis = spec.nemesis
    if nemesis is None:
        return
    times = {"every": nemesis.every, "for": nemesis.for_, "start": nemesis.start, "until": nemesis.until}
    for key, time in times.items():
        if time is not None:
            _whole(report, ("nemesis", key), time, spec.tick)
    first = nemesis.every if nemesis.start is None else nemesis.start
    until = spec.duration if nemesis.until is None else nemesis.until
    if until - first < nemesis.for_:
        span = f"from {show_time(first)} to {show_time(until)}"
        report.add(("nemesis", "for"), f"no fault of {show_time(nemesis.for_)} fits: it acts {span}")
    most = _most_faults(spec)
    if (drawn := nemesis_faults(nemesis, spec)) + len(spec.faults) > most:
        message = f"{drawn} faults, one every {show_time(nemesis.every)}, expected at most {most} in a scenario"
        report.add(("nemesis", "every"), message, "make it rarer, or end it earlier with until")
    links = _graph_links(spec)
    for index, pick in enumerate(nemesis.pick):
        path = ("nemesis", "pick", index)
        if pick.drawn is not None:
            if spec.network.ideal and pick.drawn not in OF_THE_WORLD:
                report.add(path, f"{pick.drawn} needs a network, and this one is ideal", "give the network a period")
        elif _one_action(pick, path, report):
            _fault_targets(spec, report, path, pick, links)


def _one_action(fault: FaultAction, path: tuple[str | int, ...], report: Report) -> bool:
    given_actions = [name for name in ACTIONS if getattr(fault, name) is not None]
    if len(given_actions) != 1:
        got = " and ".join(given_actions) or "none"
        report.add(path, f"does exactly one thing, got {got}", f"one of {', '.join(ACTIONS)}")
    return len(given_actions) == 1


def _fault_targets(
    spec: ScenarioSpec, report: Report, path: tuple[str | int, ...], fault: FaultAction, links: tuple[Link, ...]
) -> None:
    kind = action(fault)
    if spec.network.ideal and kind not in OF_THE_WORLD:
        report.add(path, f"{kind} needs a network, and this one is ideal", "give the network a period")
        return
    if does_nothing(fault):
        report.add((*path, kind), "changes nothing: give it a value", key=True)
        return
    if kind == "partition":
        try:
            cut = partition(fault.partition or "", spec.vehicles, spec.seed, "", links)
        except FaultError as error:
            report.add((*path, kind), error.message, error.hint)
            return
        drawn = fault.partition in ("one", "majority", "ring", "bridge")  # may cut none, this time
        if not cut and not drawn:
            report.add((*path, kind), "cuts no link of the graph")
        return
    if kind == "link" and not fault.link:
        report.add((*path, kind), "names no link", "write link 1->2: loss 30%")
        return
    if kind in ("link", "down", "up"):
        for text in (fault.link or ()) if kind == "link" else [getattr(fault, kind)]:
            if not select(parse_selector(text or ""), links) and text != "*":
                report.add((*path, kind), f"the graph has no link {text}")
        return
    for number in vehicles_of(fault):
        if not 1 <= number <= spec.vehicles:
            report.add((*path, kind), f"there is no vehicle {number}: they are 1 to {spec.vehicles}")


def _per_vehicle(spec: ScenarioSpec, report: Report) -> None:
    seen: dict[str, str] = {}
    for text in report.keys("per_vehicle"):
        try:
            numbers = vehicle_numbers(text)
        except QuantityError:
            continue  # reported by the schema
        if _packed(text) in seen:
            report.add(("per_vehicle", text), f'the same vehicles as "{seen[_packed(text)]}"', key=True)
        seen[_packed(text)] = text
        for number in numbers:
            if not 1 <= number <= spec.vehicles:
                message = f"there is no vehicle {number}: they are 1 to {spec.vehicles}"
                report.add(("per_vehicle", text), message, key=True)
                break


def _laws(spec: ScenarioSpec, report: Report) -> None:
    """Every law that is named exists, and can be made with its parameters."""
    places: list[tuple[tuple[str, ...], Any]] = [((), spec)]
    places += [(("per_vehicle", numbers), overrides) for numbers, overrides in spec.per_vehicle.items()]
    for path, place in places:
        for kind in ("agent", "controller", "guidance", "tracking"):
            section = getattr(place, kind)
            if section is None or section.law is None:
                if section is not None and getattr(section, "parameters", None):
                    report.add((*path, kind, "parameters"), "belong to a law: name it with law", key=True)
                continue
            _law(report, (*path, kind), kind, Law(section.law, section.parameters or {}))


def _law(report: Report, path: tuple[str, ...], kind: str, law: Law) -> None:
    ours = list(CONTROLLERS) if kind == "controller" else list(BUILT_IN[kind])
    if law.name in ours:
        if law.parameters:
            report.add((*path, "parameters"), f"{law.name} takes none: its gains are keys of guidance and tracking")
        return
    at = (*path, "law")
    typed = report.typed(at)
    if not (typed or report.policy.imports):
        return
    try:
        report.policy.admit(kind, law, report.folder, typed=typed)
        load(kind, law)
    except UntrustedError as error:
        report.refuse(at, f"{law.name}: {error.problem}", error.hint)
    except PluginError as error:
        if ":" not in law.name and "does not load" not in error.problem:
            close = nearest(law.name, ours) if ours else ""
            known = f"known: {', '.join(ours)}, or package.module:Class" if ours else "write package.module:Class"
            report.add(at, f'there is no {kind} "{law.name}"', close or known)
        else:
            report.add(at, f"{law.name}: {error.problem}", error.hint)


def _effective(spec: ScenarioSpec, report: Report) -> None:
    """A parameter that no law reads is a mistake, not a comment."""
    for kind in ("guidance", "tracking"):
        for path, section in _layers(spec, kind):
            where = vehicle_numbers(path[1]) if path else range(spec.vehicles + 1)
            names = {law_names(merged(spec, i)) for i in where}
            if any(n is not None and ":" in n[kind == "tracking"] for n in names):
                continue
            running = {n[kind == "tracking"] for n in names if n is not None}
            keys: set[str] = set().union(*(used(kind, law) for law in running))
            for key in given(section).keys() - {"law", "parameters"} - keys:
                laws = ", ".join(sorted(running)) or "a controller that replaces it"
                report.add((*path, kind, key), f"has no effect on {kind} law {laws}", key=True)
            if given(section).get("law") and not running:
                message = "has no effect beside a controller that replaces guidance and tracking"
                report.add((*path, kind, "law"), message, key=True)


def _vehicles(spec: ScenarioSpec, report: Report) -> None:
    """Each vehicle's numbers can be read, and make a vehicle; so does what the controller believes."""
    for entries, choice in _choices(spec):
        assert choice.vehicle is not None and choice.model_error is not None
        try:
            params, _ = vehicle(choice.vehicle, report.folder)
        except VehicleFileError as error:
            for problem in error.problems:
                report.add(report.origin(entries, "vehicle", "model") or ("vehicle", "model"), problem)
            continue
        for problem in mass_problems(params):
            report.add(report.origin(entries, "vehicle") or ("vehicle",), problem)
        if not mass_problems(params):
            for problem in mass_problems(wrong_model(params, choice.model_error)):
                report.add(report.origin(entries, "model_error") or ("model_error",), f"with it, {problem}")


def _velocity_bounds(spec: ScenarioSpec, report: Report) -> None:
    """Strictly inside, the QP is feasible for every consensus error: some k > 0 exists on each axis."""
    low, high = _desired_velocity(spec)
    for entries, law, section, name in _guidance(spec):
        if law != "optimal":
            continue
        preset = profile(name)[0]
        bounds: dict[str, Vec3] = {
            "rho_lo": section.rho_lo or preset.rho_lo,
            "rho_hi": section.rho_hi or preset.rho_hi,
        }
        for bound_name, bound in bounds.items():
            sign, speeds = (1.0, low) if bound_name == "rho_lo" else (-1.0, high)
            for axis, limit, speed in zip("xyz", bound, speeds, strict=True):
                if sign * limit < sign * speed:
                    continue
                ours = report.origin(entries, "guidance", bound_name)
                side, extreme = ("below", "least ") if sign > 0 else ("above", "greatest ")
                extreme = "" if low == high else extreme
                report.add(
                    ours or _reference_place(spec),
                    f"{bound_name} {show_vector(bound, SPEED)} must be {side} the {extreme}reference velocity "
                    f"{_rounded(speeds)} on every axis; it is not on {axis}",
                    "" if ours else f"the bound is that of profile {name}; set {_key_of(entries, bound_name)}",
                )
                break


def _key_of(entries: Entries, key: str) -> str:
    """The nearest key that sets a guidance parameter of the vehicles that these entries name."""
    return f"per_vehicle.{entries[-1]}.guidance.{key}" if entries else f"guidance.{key}"


def _rounded(speeds: Vec3) -> str:
    return show_vector(tuple(float(f"{speed:.4g}") for speed in speeds), SPEED)


def _reference_place(spec: ScenarioSpec) -> tuple[str, ...]:
    return ("reference", "velocity") if spec.reference.velocity is not None else ("reference", "speed")


def _desired_velocity(spec: ScenarioSpec) -> tuple[Vec3, Vec3]:
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
            for plan in _plans(spec):
                rate = plan.at(t).velocity
                for axis in range(3):
                    low[axis] = min(low[axis], velocity[axis] + rate[axis])
                    high[axis] = max(high[axis], velocity[axis] + rate[axis])
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _plans(spec: ScenarioSpec) -> tuple[Offset, ...]:
    shapes = [spec.formation, *(spec.formation.changes or ())]
    if any((f.offsets is None) == (f.shape is None) for f in shapes):
        raise UnknownValueError
    if any(f.offsets is not None and len(f.offsets) != spec.vehicles for f in shapes):
        raise UnknownValueError
    return plans(spec.formation, spec.vehicles)


def _gain_bounds(spec: ScenarioSpec, report: Report) -> None:
    for entries, law, section, name in _guidance(spec):
        preset = profile(name)[0]
        k_min, k_max = section.k_min or preset.k_min, section.k_max or preset.k_max
        if k_min > k_max and {"k_min", "k_max"} <= used("guidance", law):
            path = report.origin(entries, "guidance", "k_max") or report.origin(entries, "guidance", "k_min")
            assert path is not None  # no profile is wrong by itself
            given_both = section.k_min is not None and section.k_max is not None
            hint = "" if given_both else f"the other one is that of profile {name}"
            report.add(path, f"k_min {show(k_min, RATE)} is above k_max {show(k_max, RATE)}", hint)


def _cosine_guard(spec: ScenarioSpec, report: Report) -> None:
    for path, section in _layers(spec, "tracking"):
        if section.cos_eps is not None and section.cos_eps >= 1.0:
            report.add((*path, "tracking", "cos_eps"), f"is a cosine and must be below 1, got {section.cos_eps!r}")


RULES: tuple[Callable[[ScenarioSpec, Report], None], ...] = (
    _duration,
    _network_period,
    _policies,
    _snapshot,
    _qp_period,
    _reference,
    _formation,
    _initial,
    _graph_form,
    _edges,
    _followers,
    _knowledge,
    _links,
    _acoustic,
    _talking,
    _per_vehicle,
    _faults,
    _nemesis,
    _checks,
    _max_age,
    _connected,
    _recovery_time,
    _laws,
    _effective,
    _vehicles,
    _velocity_bounds,
    _gain_bounds,
    _cosine_guard,
)
