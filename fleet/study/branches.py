"""Parts of a run: from its start, or from a snapshot of another part, with draws of their own, until a check is near.

Draws before the run begins (initial states, clocks, faults of a nemesis) and draws of agents belong to the seed. Draws
of world and network during the run belong to the salt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import inf
from typing import Any, NamedTuple

from fleet.analysis.preflight import may_draw
from fleet.analysis.verdicts import judge
from fleet.execution.clock import GrantPolicy
from fleet.execution.external_agents import refuse
from fleet.execution.in_process import in_process
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot, Start
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from fleet.study.errors import StudyError
from fleet.study.row import PartRow, Row
from netem.condition import Link
from netem.grammar import parse_selector, select
from netem.medium import PERFECT
from netem.transit import PendingPacket
from netem.wire.messages import Command, Fate, Frame

_FAILED = -1e-300  # the margin of a check that failed at its limit: below 0
# Whose margin is the least over the time, so that a part of a run can go on from what it was before.
_OF_THE_TIME = ("formation_error", "consensus_error", "min_separation", "max_age")
# Others are drawn before a run begins, or with a state that a snapshot has.
_OF_THE_WHOLE_SEED = ("current", "navigation", "traces", "acoustic channel")


class Branch(NamedTuple):
    """A part of a run."""

    check: str  # its margin counts
    salt: int  # changes all draws from here on; 0: the draws of the run with this seed
    start: bytes = b""  # the snapshot to start from; empty: the start of the run
    best: float = inf  # the least margin so far
    level: float | None = None  # it ends as soon as the margin is at or below this; None: at the end of the run


class _ReachedError(Exception):
    """The margin is at the level."""


class _Path:
    """A sink of the journal: keeps a snapshot whenever the margin is smaller than ever before.

    All draws after a snapshot are made anew. So the margin must depend only on the snapshot and on the time before it.
    The snapshot has the true states at its tick. It does not have the agents' signals at its tick, since these depend
    on measurements at that tick. So the margin of a signal counts only the samples before.
    """

    def __init__(
        self, branch: Branch, margin: Callable[[], float], certain: Callable[[Snapshot], float] | None
    ) -> None:
        self.best = branch.best
        self.places: list[tuple[float, bytes]] = []  # margin, snapshot
        self._level, self._margin, self._certain = branch.level, margin, certain
        self._of_signal = branch.check not in _OF_THE_TIME
        self._before = inf  # the margin before the frame of a snapshot

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        if self._of_signal and frame.memory:
            self._before = self._margin()

    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...

    def snapshot(self, snapshot: Snapshot) -> None:
        margin = self._before if self._of_signal else self._margin()
        if self._certain is not None:
            margin = min(margin, self._certain(snapshot))
        if margin >= self.best:
            return
        self.best = margin
        self.places.append((margin, snapshot.to_bytes()))
        if self._level is not None and margin <= self._level:
            raise _ReachedError


def run_branch(scenario: Scenario, branch: Branch, progress: Callable[[float], None]) -> Row:
    start = None
    if branch.start:
        start = Start(Snapshot.from_bytes(branch.start), "")
    begin = 0 if start is None else start.snapshot.tick

    def margin() -> float:
        verdict = next((one for one in judge(scenario, journal, 0) if one.check == branch.check), None)
        if verdict is None or verdict.margin is None:  # one that is not judged has none, either
            return inf
        return verdict.margin.value if verdict.passed else min(verdict.margin.value, _FAILED)

    path = _Path(branch, margin, certain_margin(scenario) if branch.check == "max_age" else None)
    runner = in_process(scenario, path, start=start, salt=branch.salt)
    journal = runner.journal
    try:
        runner.serve(GrantPolicy.of(scenario, begin=begin), lambda: progress(0.0))
        journal.finish()
        best = min(path.best, margin())
    except _ReachedError:
        best = path.best
    return Row(seed=scenario.seed, status="pass", part=PartRow(best, path.places, journal.framed - begin))


def refuse_branches(scenario: Scenario, check: str) -> None:
    """See whether parts of a run can be made and put together. Raises StudyError: they cannot."""
    refuse(scenario, "a run of a study")
    known = list(checks_over_time(scenario))
    if check not in known:
        has = ", ".join(known) or "none"
        text = f"the check {check} has no margin that is the least over the time, or does not exist"
        raise StudyError(f"{scenario.name}: {text}. You can use: {has}")
    if others := [part for part in may_draw(scenario) if part in _OF_THE_WHOLE_SEED]:
        text = f"{', '.join(others)} cannot be drawn again from a snapshot on"
        raise StudyError(f"{scenario.name}: {text}; count with fleet sweep instead")
    if scenario.spec.triggers:
        raise StudyError(f"{scenario.name}: behind a snapshot its triggers would begin other faults; use fleet sweep")
    if not scenario.memory_ticks:
        raise StudyError(f"{scenario.name} has no snapshots: log.snapshot is 0 s, or a law cannot save its state")


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


# The ages of information that a run certainly reaches from a snapshot on, whatever is drawn after it.
#
# A snapshot of tick S has the fates of all packets sent before S: they are in it, or lost. A packet sent at S or later
# arrives L ticks after S at the earliest, so the ages of the ticks S to S + L - 1 are known.
#
# A margin that leaves these ages out is late. When it gets smaller, the fate of the next packet is drawn already.
# All runs that continue from there then share its fate, and new draws do not help.


def certain_margin(scenario: Scenario) -> Callable[[Snapshot], float]:
    """Make a function that computes the margin of `max_age` [s] from a snapshot.

    It covers the ticks for which the snapshot already decides every age. If the margin is below 0, the check fails.
    """
    check = scenario.spec.checks.max_age
    assert check is not None
    tick_ns, after = scenario.tick_ns, -(-check.after // scenario.tick_ns)
    limit_s, tick_s = check.below / 1e9, tick_ns / 1e9
    ahead = {link: _known_ticks(scenario, link) for link in select(parse_selector(check.links), scenario.graph.links)}

    def margin(snapshot: Snapshot) -> float:
        on_the_way = _on_the_way(snapshot.network)
        heard = {(src, dst): sent for src, dst, sent in snapshot.heard}
        oldest = -1
        for link, ticks in ahead.items():
            some = range(max(after, snapshot.tick), min(snapshot.tick + ticks, scenario.ticks))
            oldest = max(oldest, _oldest(heard[link], on_the_way.get(link, ()), some))
        margin_s = limit_s - oldest * tick_s  # to the last bit that of the verdict: levels are compared with it
        return margin_s if oldest * tick_ns < check.below else min(margin_s, -1e-9)

    return margin


def _oldest(heard: int, packets: Iterable[PendingPacket], ticks: range) -> int:
    """The largest age in some ticks; -1: there are none."""
    there = [(packet.due_tick, packet.sent_tick) for packet in packets if not packet.corrupted]
    return max((t - max([heard, *(sent for due, sent in there if due <= t)]) for t in ticks), default=-1)


def _on_the_way(network: dict[str, Any]) -> dict[Link, list[PendingPacket]]:
    found: dict[Link, list[PendingPacket]] = {}
    for values in (*network["announced"], *network["pending"]):
        packet = PendingPacket(*values)
        found.setdefault((packet.src, packet.dst), []).append(packet)
    return found


def _known_ticks(scenario: Scenario, link: Link) -> int:
    """The least time from sending to arrival on a link [ticks]; 1 where a packet may overtake others."""
    config = scenario.netem_config
    if config.faults or config.changing or config.clocks or config.acoustic is not None:
        return 1
    condition = config.conditions.get(link, PERFECT)
    if condition.reorder or (condition.jitter_ns and condition.distribution != "uniform"):
        return 1
    return max(1, -(-(condition.delay_ns - condition.jitter_ns) // scenario.tick_ns))
