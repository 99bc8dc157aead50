"""Rules on faults and on the nemesis."""

from __future__ import annotations

from fleet.quantities import show_time
from fleet.scenario.rules.report import Report, whole_multiple
from fleet.scenario.rules.views import graph_links
from fleet.scenario.schema.faults import FaultAction
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.nemesis import count as nemesis_faults
from fleet.scenario.sections.partitions import FaultError, partition
from fleet.scenario.sections.timeline import ACTIONS, OF_THE_WORLD, action, does_nothing, vehicles_of
from fleet.scenario.sections.timeline import plan as fault_plan
from netem.condition import Link
from netem.selectors import parse_selector, select

MOST_FAULTS = 5000  # of one scenario, those of its nemesis included: each is looked at in every tick
MOST_TARGETS = 100_000  # faults times vehicles: each may be about all of them


def fault_names(spec: ScenarioSpec) -> tuple[list[str], set[str]]:
    """The ids of all faults in their order, and those of which nothing says that they end before the run."""
    events = fault_plan(spec, graph_links(spec)).events
    last = spec.duration // spec.tick
    ending = {event.fault for event in events if event.action == "ends" and event.tick < last}
    written = {fault.id or f"f{n}": fault for n, fault in enumerate(spec.faults, start=1)}
    lasting = {name for name, fault in written.items() if fault.for_ is None and name not in ending}
    return list(dict.fromkeys([*written, *(event.fault for event in events)])), lasting


def faults(spec: ScenarioSpec, report: Report) -> None:
    if len(spec.faults) > (most := most_faults(spec)):
        report.add(("faults",), f"{len(spec.faults)} faults, expected at most {most}")
        return
    links = graph_links(spec)
    seen: dict[str, int] = {}
    for index, fault in enumerate(spec.faults):
        path: tuple[str | int, ...] = ("faults", index)
        if not one_action(fault, path, report):
            continue
        name = fault.id or f"f{index + 1}"
        if name in seen:
            report.add((*path, "id"), f'fault {seen[name] + 1} is called "{name}" as well')
        seen[name] = index
        whole_multiple(report, (*path, "at"), fault.at, spec.tick)
        if fault.for_ is not None:
            whole_multiple(report, (*path, "for"), fault.for_, spec.tick)
        fault_targets(spec, report, path, fault, links)


def most_faults(spec: ScenarioSpec) -> int:
    return min(MOST_FAULTS, MOST_TARGETS // spec.vehicles)


def nemesis(spec: ScenarioSpec, report: Report) -> None:
    nemesis = spec.nemesis
    if nemesis is None:
        return
    times = {"every": nemesis.every, "for": nemesis.for_, "start": nemesis.start, "until": nemesis.until}
    for key, time in times.items():
        if time is not None:
            whole_multiple(report, ("nemesis", key), time, spec.tick)
    first = nemesis.every if nemesis.start is None else nemesis.start
    until = spec.duration if nemesis.until is None else nemesis.until
    if until - first < nemesis.for_:
        span = f"from {show_time(first)} to {show_time(until)}"
        report.add(("nemesis", "for"), f"no fault of {show_time(nemesis.for_)} fits: it acts {span}")
    most = most_faults(spec)
    if (drawn := nemesis_faults(nemesis, spec)) + len(spec.faults) > most:
        message = f"{drawn} faults, one every {show_time(nemesis.every)}, expected at most {most} in a scenario"
        report.add(("nemesis", "every"), message, "make it rarer, or end it earlier with until")
    links = graph_links(spec)
    for index, pick in enumerate(nemesis.pick):
        path = ("nemesis", "pick", index)
        if pick.drawn is not None:
            if spec.network.ideal and pick.drawn not in OF_THE_WORLD:
                report.add(path, f"{pick.drawn} needs a network, and this one is ideal", "give the network a period")
        elif one_action(pick, path, report):
            fault_targets(spec, report, path, pick, links)


def one_action(fault: FaultAction, path: tuple[str | int, ...], report: Report) -> bool:
    given_actions = [name for name in ACTIONS if getattr(fault, name) is not None]
    if len(given_actions) != 1:
        got = " and ".join(given_actions) or "none"
        report.add(path, f"does exactly one thing, got {got}", f"one of {', '.join(ACTIONS)}")
    return len(given_actions) == 1


def fault_targets(
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
