"""Rules on faults and on the nemesis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from fleet.quantities import show_time
from fleet.scenario.faults.kind import LinkFaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_links import PartitionFault
from fleet.scenario.faults.partitions import is_drawn, partition
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import (
    Report,
    known_links,
    no_whole_ticks,
    unknown_vehicle,
    vehicles_exist,
    whole_multiple,
)
from fleet.scenario.schema.faults import ACTIONS, FaultAction, FaultSection
from fleet.scenario.schema.nemesis import OF_TARGET, NemesisSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections import episodes
from fleet.scenario.sections.liveness import heal_time
from fleet.scenario.sections.nemesis import fault_count
from fleet.scenario.sections.swarm import span
from netem.condition import Link
from netem.errors import SelectorError, TextError
from netem.link_selector import parse_selector, select

MOST_FAULTS = 5000  # with the faults of its nemesis; the cores test each fault in every tick
MOST_TARGETS = 100_000  # faults times vehicles, since a fault may concern all vehicles


def fault_names(parts: Parts) -> tuple[list[str], set[str]]:
    """The ids of all faults in their order, and those of the faults that last to the end of the run."""
    spec, events = parts.explicit, parts.faults.events
    last = spec.duration // spec.tick
    ending = {event.fault for event in events if event.action == "ends" and event.tick < last}
    written = {fault.id or f"f{n}": fault for n, fault in enumerate(spec.faults, start=1)}
    lasting = {name for name, fault in written.items() if fault.for_ is None and name not in ending}
    return list(dict.fromkeys([*written, *(event.fault for event in events)])), lasting


def faults(parts: Parts, report: Report) -> None:
    spec = parts.spec
    if len(spec.faults) > (most := most_faults(spec)):
        report.add(("faults",), f"{len(spec.faults)} faults, expected at most {most}")
        return
    links = parts.links
    seen: dict[str, int] = {}
    for index, fault in enumerate(spec.faults):
        path: tuple[str | int, ...] = ("faults", index)
        name = fault.id or f"f{index + 1}"
        if name in seen:
            problem = f'fault {seen[name] + 1} has the id "{name}" already'
            report.add((*path, "id"), problem, "give every fault its own id")
        seen[name] = index
        report_fault(report, path, fault, spec, links)


def most_faults(spec: ScenarioSpec) -> int:
    return min(MOST_FAULTS, MOST_TARGETS // spec.vehicles)


def nemesis(parts: Parts, report: Report) -> None:
    spec = parts.spec
    nemesis = spec.nemesis
    if nemesis is None:
        return
    _keys_of_mode(nemesis, report)
    if nemesis.mode is None and None in (nemesis.every, nemesis.for_, nemesis.pick):
        return
    for key in ("every", "for_", "start", "until", "heal"):
        if (time := getattr(nemesis, key)) is not None:
            whole_multiple(report, ("nemesis", key.rstrip("_")), time, spec.tick)
    if nemesis.mode is None:
        _grid(nemesis, spec, report)
    else:
        _mode(nemesis, parts, report)
    most = most_faults(spec)
    if (drawn := fault_count(nemesis, parts.targets)) + len(spec.faults) > most:
        key, pace = ("every", f", one every {show_time(nemesis.every)}") if nemesis.every else ("mean", "")
        message = f"{drawn} faults{pace}, expected at most {most} in a scenario"
        report.add(("nemesis", key), message, "make it rarer, or end it earlier with until")
    links = parts.links
    for index, pick in enumerate(nemesis.pick or ()):
        path = ("nemesis", "pick", index)
        if pick.drawn is not None:
            if nemesis.mode is None and pick.drawn not in OF_TARGET:
                report.add(path, f"{pick.drawn} has a strength that is drawn, which needs a mode", "write mode: swarm")
            elif spec.network.ideal and not acts_on_world(pick.drawn):
                report.add(path, f"{pick.drawn} needs a network, and this one is ideal", "give the network a period")
        else:
            report_fault(report, path, pick, spec, links)


_OF_GRID = ("every", "for_")
_OF_MODES = {
    "mean": ("swarm", "liveness"), "aims": ("swarm", "liveness"), "leader": ("swarm", "liveness"),
    "unit": ("episodes",), "watch": ("episodes",), "core": ("liveness",), "heal": ("liveness",),
}  # fmt: skip


def _keys_of_mode(nemesis: NemesisSection, report: Report) -> None:
    """Each form of a nemesis has keys of its own."""
    for key in _OF_GRID:
        name = key.rstrip("_")
        if nemesis.mode is None and getattr(nemesis, key) is None:
            report.add_missing(("nemesis",), name, "")
        if nemesis.mode is not None and getattr(nemesis, key) is not None:
            problem = f"has no effect with mode: {nemesis.mode}, since the seed draws it"
            report.add(("nemesis", name), problem, "leave it out", key=True)
    if nemesis.mode is None and nemesis.pick is None:
        report.add_missing(("nemesis",), "pick", "")
    for key, modes in _OF_MODES.items():
        if getattr(nemesis, key) is not None and nemesis.mode not in modes:
            report.add(("nemesis", key), f"has no effect without mode: {modes[0]}", key=True)
    if nemesis.mode == "liveness" and nemesis.most_silent is not None:
        problem = "has no effect with mode: liveness, since all vehicles outside the core stay broken"
        report.add(("nemesis", "most_silent"), problem, "name a core with core", key=True)
    if nemesis.mode == "liveness" and nemesis.until is not None:
        problem = "has no effect with mode: liveness, since its faults end at heal"
        report.add(("nemesis", "until"), problem, "write heal in place of until", key=True)


def _grid(nemesis: NemesisSection, spec: ScenarioSpec, report: Report) -> None:
    """A fault fits into the time of a nemesis without a mode."""
    assert nemesis.every is not None and nemesis.for_ is not None
    first = nemesis.every if nemesis.start is None else nemesis.start
    until = spec.duration if nemesis.until is None else nemesis.until
    if until - first < nemesis.for_:
        begin = "every" if nemesis.start is None else "start"
        end = "the end of the run" if nemesis.until is None else "until"
        span = f"from {show_time(first)} ({begin}) to {show_time(until)} ({end})"
        hint = "make the faults shorter, or let them begin earlier"
        report.add(("nemesis", "for"), f"no fault of {show_time(nemesis.for_)} fits {span}", hint)


def _mode(nemesis: NemesisSection, parts: Parts, report: Report) -> None:
    """The times of a swarm are in order, and its vehicles are there."""
    spec = parts.spec
    if nemesis.mode == "episodes":
        _episodes(nemesis, parts, report)
        return
    start, until = span(nemesis, parts.targets)
    end, key = until, "until"
    if nemesis.mode == "liveness":
        end, key = heal_time(nemesis, parts.targets), "heal"
        if end >= spec.duration:
            problem = f"{show_time(end)} is not before the end of the run, {show_time(spec.duration)}"
            report.add(("nemesis", key), problem, "heal the core earlier")
    if start >= end:
        problem = f"{show_time(start)} is not before the end of the faults, {show_time(end)}"
        report.add(("nemesis", "start"), problem, "start earlier, or end later")
    if nemesis.leader is not None:
        vehicles_exist(spec, report, ("nemesis", "leader"), str(nemesis.leader))
    if nemesis.core is not None:
        vehicles_exist(spec, report, ("nemesis", "core"), nemesis.core)


def _episodes(nemesis: NemesisSection, parts: Parts, report: Report) -> None:
    """There is room for an episode, and each kind can be drawn."""
    planned = episodes.plan(nemesis, parts.targets)
    if parts.spec.network.ideal:
        report.add(("nemesis", "mode"), "episodes need a network, and this one is ideal", "give the network a period")
    if not planned.begins:
        units = episodes.UNITS + episodes.QUIET
        problem = f"has no room for an episode, {units} units of {show_time(planned.unit)} ({planned.origin})"
        report.add(("nemesis",), problem, "make the run longer, or state a shorter unit")
    for index, pick in enumerate(nemesis.pick or ()):
        if pick.drawn not in episodes.KINDS:
            report.add(("nemesis", "pick", index), f"episodes have only {', '.join(episodes.KINDS)}")


def report_fault(
    report: Report, path: tuple[str | int, ...], fault: FaultAction, spec: ScenarioSpec, links: tuple[Link, ...]
) -> None:
    """Report every mistake in the fault at `path`."""
    for problem in fault_problems(fault, spec, links):
        at = (*path, problem.key) if problem.key else path
        report.add(at, problem.message, problem.hint, key=problem.at_key)


class FaultProblem(NamedTuple):
    """One mistake in a fault."""

    key: str  # key of the fault; "": the mistake is in the fault as a whole
    message: str
    hint: str = ""
    at_key: bool = False  # shown at the key and not at its value

    def __str__(self) -> str:
        text = f"{self.key or 'fault'}: {self.message}"
        return f"{text}; {self.hint}" if self.hint else text


def fault_problems(fault: FaultAction, spec: ScenarioSpec, links: tuple[Link, ...]) -> Iterator[FaultProblem]:
    """The mistakes in one fault of a scenario, of its nemesis (without times), or of an operator."""
    given_actions = [name for name in ACTIONS if getattr(fault, name) is not None]
    if len(given_actions) != 1:
        got = " and ".join(given_actions) or "none"
        yield FaultProblem("", f"does exactly one thing, got {got}", f"one of {', '.join(ACTIONS)}")
        return
    if isinstance(fault, FaultSection):
        for key, time in (("at", fault.at), ("for", fault.for_)):
            if time is not None and (wrong := no_whole_ticks(time, spec.tick)):
                yield FaultProblem(key, *wrong)
    yield from _target_problems(fault, spec, links)


def acts_on_world(word: str) -> bool:
    """Whether a kind, or what a nemesis draws, needs no network."""
    return word in KINDS and KINDS[word].acts_on == "vehicle"


def _target_problems(fault: FaultAction, spec: ScenarioSpec, links: tuple[Link, ...]) -> Iterator[FaultProblem]:
    """Mistakes in the links or vehicles of a fault, and in its effect on them."""
    kind, values = fault.kind, fault.values
    name = kind.name
    if spec.network.ideal and not acts_on_world(name):
        yield FaultProblem("", f"{name} needs a network, and this one is ideal", "give the network a period")
    elif kind.does_nothing(values):
        yield FaultProblem(name, "changes nothing: give it a value", at_key=True)
    elif isinstance(kind, PartitionFault):
        try:
            cut = partition(values, spec.vehicles, spec.seed, "", links)
        except TextError as error:
            message = error.in_names(tuple(spec.nodes or ())) if isinstance(error, SelectorError) else error.message
            yield FaultProblem(name, message, error.hint)
            return
        if not cut and not is_drawn(values):  # one that is drawn may cut no link, this time
            yield FaultProblem(name, "cuts no link of the graph")
    elif isinstance(kind, LinkFaultKind):
        if not kind.in_water and spec.network.acoustic is not None:
            yield FaultProblem(name, "acts on links of their own, and this network is acoustic", at_key=True)
        for uneven in filter(None, (no_whole_ticks(time, spec.tick) for time in kind.times(values))):
            yield FaultProblem(name, *uneven)
        if not (selectors := kind.selectors(values)):
            yield FaultProblem(name, "names no link", "write link 1->2: loss 30%")
        for text in selectors:
            if not select(parse_selector(text), links) and text != "*":
                yield FaultProblem(name, f"the graph has no link {text}", known_links(links))
    else:
        for wrong in filter(None, (unknown_vehicle(spec, number) for number in kind.vehicles(values))):
            yield FaultProblem(name, wrong)
