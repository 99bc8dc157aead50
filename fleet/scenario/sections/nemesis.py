"""Random faults from the seed: a `nemesis:` becomes explicit faults before the run starts.

Without a mode they begin on a grid of times, as this module has it; `swarm`, `episodes` and `liveness` have the modes.
Each fault is a pure function of (seed, number of the fault), so the faults can be printed, edited and run again.
The word, and the idea of faults that come and go by themselves, are Jepsen's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fleet.scenario.faults.kind import LinkFaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_links import PartitionFault
from fleet.scenario.faults.partitions import DRAWN_PARTITIONS, partition
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import NemesisPick, NemesisSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections import episodes, liveness, swarm
from fleet.scenario.sections.nemesis_targets import NemesisTargets, free_name
from netem.condition import Link
from netem.draws import bits
from netem.link_selector import Selector

PURPOSE = "nemesis"
PARTITIONS = ("halves", *DRAWN_PARTITIONS)


def explicit(targets: NemesisTargets) -> ScenarioSpec:
    """The specification of a scenario with the faults that its nemesis draws written out after its own.

    With `mode: liveness` its checks judge the core. No id of a fault is one of the scenario's own.
    """
    spec, nemesis = targets.spec, targets.spec.nemesis
    if nemesis is None:
        return spec
    changes: dict[str, Any] = {"nemesis": None}
    match nemesis.mode:
        case "liveness":
            drawn = liveness.faults(nemesis, targets)
            changes["checks"] = liveness.core_checks(spec.checks, nemesis, targets)
        case "episodes":
            drawn, triggers = episodes.draw(nemesis, targets)
            changes["triggers"] = [*spec.triggers, *triggers]
        case "swarm":
            drawn = swarm.to_sections(swarm.draw(nemesis, targets), targets)
        case _:
            drawn = _grid(spec, nemesis, targets.links)
    kept = keep_within_limit(nemesis.most_silent, drawn, spec.faults)
    return spec.model_copy(update=changes | {"faults": [*spec.faults, *kept]})


def keep_within_limit(
    most_silent: int | None, faults: Sequence[FaultSection], own: Sequence[FaultSection] = ()
) -> list[FaultSection]:
    """Leave out faults by which more than `most_silent` vehicles would be dead, suspended or mute at once.

    The scenario's `own` faults are never left out, but the vehicles that they silence count.
    """
    silent = [_silence(fault) for fault in own]
    kept = list[FaultSection]()
    for fault in faults:
        begin, end, who = _silence(fault)
        quiet = {i for at, until, some in silent if at <= begin < until for i in some}
        if most_silent is None or not who or len(quiet | who) <= most_silent:
            kept.append(fault)
            silent.append((begin, end, who))
    return kept


def _silence(fault: FaultSection) -> tuple[int, float, frozenset[int]]:
    """From when to when a fault silences which vehicles [ns]."""
    who = fault.kind.vehicles(fault.values) if fault.kind.silences else ()
    return fault.at, float("inf") if fault.for_ is None else fault.at + fault.for_, frozenset(who)


def _grid(spec: ScenarioSpec, nemesis: NemesisSection, links: Sequence[Link]) -> list[FaultSection]:
    """The faults that begin one every so often, in order of time."""
    taken = {fault.id for fault in spec.faults}
    faults: list[FaultSection] = []
    for number, at in enumerate(_times(nemesis, spec), start=1):
        name = free_name(f"nemesis-{number}", taken)
        picks = _picks(nemesis, links)
        if not picks:
            break
        pick = picks[_draw(spec, number, 0, len(picks))]
        if pick.drawn is None:
            body = pick.model_dump(exclude_none=True, exclude_defaults=True, by_alias=True)
        else:
            body = {pick.drawn: _target(pick.drawn, name, spec, number, links)}
        times = {"at": f"{at} ns", "for": f"{nemesis.for_} ns"}
        faults.append(FaultSection.model_validate({"id": name, **times, **body}))
    return faults


def fault_count(nemesis: NemesisSection, targets: NemesisTargets) -> int:
    """How many faults a nemesis draws, at most."""
    if nemesis.mode is None:
        return len(_times(nemesis, targets.spec))
    if nemesis.mode == "episodes":
        return episodes.MOST_FAULTS * len(episodes.plan(nemesis, targets).begins)
    until = liveness.heal_time(nemesis, targets) if nemesis.mode == "liveness" else None
    return sum(one.pieces for one in swarm.draw(nemesis, targets, until)) + (
        targets.spec.vehicles if nemesis.mode == "liveness" else 0
    )


def _picks(nemesis: NemesisSection, links: Sequence[Link]) -> list[NemesisPick]:
    """The kinds of fault that may be drawn. A fleet of one keeps its scenario: faults that need a link are left out."""
    return [pick for pick in nemesis.pick or () if links or not swarm.of_links(pick)]


def _times(nemesis: NemesisSection, spec: ScenarioSpec) -> range:
    """When a fault begins [ns], so that each is over by the end of the nemesis."""
    assert nemesis.every is not None and nemesis.for_ is not None  # a rule
    first = nemesis.every if nemesis.start is None else nemesis.start
    until = spec.duration if nemesis.until is None else min(nemesis.until, spec.duration)
    return range(first, until - nemesis.for_ + 1, nemesis.every)


def _target(kind: str, name: str, spec: ScenarioSpec, number: int, links: Sequence[Link]) -> str:
    if isinstance(KINDS[kind], PartitionFault):
        # The draw of a partition depends on its id, not on its place: a list that is sorted by time draws the same.
        cuts = [p for p in PARTITIONS if partition(p, spec.vehicles, spec.seed, name, links)] or ["halves"]
        return cuts[_draw(spec, number, 1, len(cuts))]
    if isinstance(KINDS[kind], LinkFaultKind):
        pairs = sorted({(min(link), max(link)) for link in links})
        return str(Selector(*pairs[_draw(spec, number, 1, len(pairs))], both=True))
    return str(1 + _draw(spec, number, 1, spec.vehicles))


def _draw(spec: ScenarioSpec, number: int, what: int, among: int) -> int:
    return bits(spec.seed, PURPOSE, number, what) % among
