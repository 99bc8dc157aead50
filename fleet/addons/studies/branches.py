"""Parts of a run: from its start, or from a moment of another part, with draws of their own, until a check is near.

Draws before the run begins (initial states, clocks, faults of a nemesis) and draws of agents belong to the seed. Draws
of world and network during the run belong to the salt. So a moment is a seed and the salts up to some ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from math import inf
from typing import NamedTuple

from msgspec.structs import replace

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.row import PartRow, Row
from fleet.analysis.randomness import may_draw
from fleet.analysis.verdicts import judge
from fleet.execution.external_agents import refuse
from fleet.execution.in_process import InProcess, start_in_process
from fleet.execution.moments import Prefix, reach
from fleet.processes.apart import can_copy, in_child_process
from fleet.recorder.log_file import NoDigest
from fleet.recorder.metrics import VehicleError
from fleet.recorder.start import Leg, Start
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.log_rates import moment_grid
from fleet.scenario.sections.timeline import Event
from netem.condition import Link
from netem.link_selector import parse_selector, select
from netem.links import PERFECT
from netem.transit import PendingPacket
from netem.wire.messages import Command, Fate, Frame

_FAILED = -1e-300  # the margin of a check that failed at its limit: below 0
# Whose margin is the least over the time, so that a part of a run can go on from what it was before.
_OF_THE_TIME = ("formation_error", "consensus_error", "min_separation", "max_age")
# Others are drawn before a run begins, or are the same for each salt.
_OF_THE_WHOLE_SEED = ("current", "navigation", "traces", "acoustic channel")


Way = tuple[tuple[int, int], ...]  # (salt, tick): the draws of each part up to its end; () is the start of a run


class Branches(NamedTuple):
    """Parts of a run that begin at the same moment."""

    check: str  # its margin counts
    way: Way  # to the moment
    salts: tuple[int, ...]  # change all draws from there on; 0: the draws of the run with this seed
    best: float = inf  # the least margin so far
    level: float | None = None  # they end as soon as the margin is at or below this; None: at the end of the run


class _Signals:
    """A sink of the journal: knows the margin of a signal before the frame of the newest moment.

    All draws after a moment are made anew. So its margin must depend only on the moment and on the time before it. At
    a moment the true states of its tick are known, and the agents' signals of its tick are not, since these depend on
    measurements at that tick. So the margin of a signal counts only the samples before.
    """

    def __init__(self, margin: Callable[[], float], grid: int) -> None:
        self._margin, self._grid, self.before = margin, grid, inf

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        if frame.tick % self._grid == 0:
            self.before = self._margin()

    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...


def run_branches(scenario: Scenario, asked: Branches, progress: Callable[[float], None]) -> list[Row]:
    """The rows of some parts of a run. The way to their moment is gone once if this process can be copied there, and it
    counts once: the first of them has its ticks.
    """
    moment = _moment(scenario, asked)
    way = asked.way[-1][1] if asked.way else 0
    rows = list[Row]()
    try:
        for number, salt in enumerate(asked.salts):
            last = number == len(asked.salts) - 1
            if not last and moment is not None and moment.run.can_be_copied and can_copy():
                rows.append(in_child_process(partial(_future, scenario, asked, salt, moment, progress)))
            else:
                rows.append(_future(scenario, asked, salt, moment, progress))
                moment = None if last else _moment(scenario, asked)
    finally:
        if moment is not None:
            moment.run.release()
    assert rows[0].part is not None
    rows[0].part = replace(rows[0].part, ticks=way + rows[0].part.ticks)
    return rows


def _moment(scenario: Scenario, asked: Branches) -> Prefix | None:
    return reach(Start(tuple(Leg(scenario, tick, salt) for salt, tick in asked.way))) if asked.way else None


def _future(
    scenario: Scenario, asked: Branches, salt: int, moment: Prefix | None, progress: Callable[[float], None]
) -> Row:
    """Go on from a moment, and keep each round at which the margin is smaller than ever before."""

    def margin() -> float:
        verdict = next((one for one in judge(scenario, run.journal, 0) if one.check == asked.check), None)
        if verdict is None or verdict.margin is None:  # one that is not judged has none, either
            return inf
        return verdict.margin.value if verdict.passed else min(verdict.margin.value, _FAILED)

    grid = moment_grid(scenario.spec)
    signals = _Signals(margin, grid) if asked.check not in _OF_THE_TIME else None
    certain = certain_margin(scenario) if asked.check == "max_age" else None
    run = start_in_process(scenario, signals or NoDigest(), None if moment is None else moment.run, salt=salt)
    run.begin()
    begin, best, places = run.granted, asked.best, list[tuple[float, int]]()
    try:
        for tick in range(begin - begin % grid + grid, scenario.ticks, grid):
            run.advance(tick)
            here = inf if certain is None else certain(tick, run)
            run.advance(tick + 1)  # with the frame of the moment
            here = min(here, margin() if signals is None else signals.before)
            progress(0.0)
            if here < best:
                best = here
                places.append((here, tick))
                if asked.level is not None and here <= asked.level:
                    return Row(seed=scenario.seed, status="pass", part=PartRow(best, places, tick - begin))
        run.advance(scenario.ticks)
        run.end()
        run.journal.finish()
        best = min(best, margin())
        return Row(seed=scenario.seed, status="pass", part=PartRow(best, places, scenario.ticks - begin))
    finally:
        run.release()


def refuse_branches(scenario: Scenario, check: str) -> None:
    """See whether parts of a run can be made and put together. Raises StudyError: they cannot."""
    refuse(scenario, "rare, which goes on from the middle of runs")
    known = list(checks_over_time(scenario))
    if check not in known:
        has = ", ".join(known) or "none"
        text = f"the check {check} has no margin that is the least over the time, or does not exist"
        raise StudyError(f"{scenario.name}: {text}. You can use: {has}")
    if others := [part for part in may_draw(scenario) if part in _OF_THE_WHOLE_SEED]:
        text = f"{', '.join(others)} cannot be drawn again from a moment on"
        raise StudyError(f"{scenario.name}: {text}; count with fleet sweep instead")
    if scenario.spec.triggers:
        raise StudyError(f"{scenario.name}: with other draws its triggers would begin other faults; use fleet sweep")


def checks_over_time(scenario: Scenario) -> Iterator[str]:
    """The checks whose margin is the least over the time."""
    checks = scenario.spec.checks
    for name in _OF_THE_TIME:
        if getattr(checks, name) is not None:
            yield name
    for key, place, name, *_ in checks.own():
        if key != "signal":
            continue
        one = (checks.signal or [])[place]
        timed = (one.eventually_within, one.for_at_least, one.agree_within, one.at_most_one, one.sometimes)
        if all(value is None for value in timed):
            yield name


def certain_margin(scenario: Scenario) -> Callable[[int, InProcess], float]:
    """Make a function that computes the margin of `max_age` [s] of a run before a round tick.

    It covers the ticks for which every age is decided already, whatever is drawn afterwards. If the margin is below 0,
    the check fails. At tick S, before its round, the fates of all packets sent before S are known: they are under way,
    or lost. A packet sent at S or later arrives L ticks after S at the earliest, so the ages of the ticks S to
    S + L - 1 are known.

    A margin that leaves these ages out is late. When it gets smaller, the fate of the next packet is drawn already. All
    runs that continue from there then share its fate, and new draws do not help.
    """
    check = scenario.spec.checks.max_age
    assert check is not None
    tick_ns, after = scenario.tick_ns, -(-check.after // scenario.tick_ns)
    limit_s, tick_s = check.below / 1e9, tick_ns / 1e9
    ahead = {link: _known_ticks(scenario, link) for link in select(parse_selector(check.links), scenario.graph.links)}

    def margin(tick: int, run: InProcess) -> float:
        on_the_way: dict[Link, list[PendingPacket]] = {}
        for packet in run.rounds.netem.under_way():
            on_the_way.setdefault((packet.src, packet.dst), []).append(packet)
        oldest = -1
        for link, ticks in ahead.items():
            some = range(max(after, tick), min(tick + ticks, scenario.ticks))
            oldest = max(oldest, _oldest(run.journal.ages.links[link].heard, on_the_way.get(link, ()), some))
        margin_s = limit_s - oldest * tick_s  # to the last bit that of the verdict: levels are compared with it
        return margin_s if oldest * tick_ns < check.below else min(margin_s, -1e-9)

    return margin


def _oldest(heard: int, packets: Iterable[PendingPacket], ticks: range) -> int:
    """The largest age in some ticks; -1: there are none."""
    there = [(packet.due_tick, packet.sent_tick) for packet in packets if not packet.corrupted]
    return max((t - max([heard, *(sent for due, sent in there if due <= t)]) for t in ticks), default=-1)


def _known_ticks(scenario: Scenario, link: Link) -> int:
    """The least time from sending to arrival on a link [ticks]; 1 where a packet may overtake others."""
    config = scenario.netem_config
    if config.faults or config.changing or config.clocks or config.acoustic is not None:
        return 1
    condition = config.conditions.get(link, PERFECT)
    if condition.reorder or (condition.jitter_ns and condition.distribution != "uniform"):
        return 1
    return max(1, -(-(condition.delay_ns - condition.jitter_ns) // scenario.tick_ns))
