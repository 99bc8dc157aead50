"""Why a check failed: its verdict, what the log says of that time, and the point of no return."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.explanation.evidence import (
    CAUSES,
    NOT_SENT,
    TOPICS,
    FaultThen,
    Gap,
    Heard,
    VehicleThen,
    evidence,
    first_older,
)
from fleet.addons.studies.explanation.last_words import SAID, SaidThen, said_before
from fleet.addons.studies.explanation.no_return import HealingSearch, NoReturn, Rerun, remake
from fleet.addons.studies.modules import Modules, modules_of
from fleet.addons.studies.sweep import check_names
from fleet.errors import FleetError
from fleet.execution.directory import SCENARIO
from fleet.logs.open_log import Log, open_log
from fleet.logs.schemas import CLOCK, FROM
from fleet.mcap.reader import digest
from fleet.repeat.recorded_run import Recorded, read_recorded_run
from fleet.result.file import ResultError, read_result
from fleet.result.result import Result
from fleet.result.verdict import Verdict
from fleet.scenario.text.yaml_reader import Source, plain, read
from fleet.scenario.text.yaml_writer import inline
from fleet.scenario.trust import Policy
from fleet.terminal import table
from netem.clock import Clock
from netem.condition import Link
from netem.link_selector import parse_selector, select
from netem.parsing import nearest


class Why(Struct, frozen=True):
    """`fleet why --json`: what made a check fail."""

    scenario: str
    seed: int
    check: str
    asked: str
    found: str
    others: list[str]
    differs: Annotated[
        list[str],
        Meta(description="Of a run that goes on from another: what its scenario has otherwise than that one."),
    ]
    origin_passed: Annotated[bool | None, Meta(description="Whether the check passed there; null: it is not known.")]
    held_until_s: Annotated[float, Meta(description="Up to when the check is known to have held.")]
    failed_s: float
    at_s: Annotated[float, Meta(description="The same, or the end of the log; everything below is of this time.")]
    faults: list[FaultThen]
    sent: int
    lost: Annotated[dict[str, int], Meta(description="By cause, how many of these had not arrived.")]
    gaps: Annotated[list[Gap], Meta(description="The most important first.")]
    vehicles: list[VehicleThen]
    said: Annotated[list[SaidThen], Meta(description="What agents had said last, in the order of time.")]
    nodes: Annotated[list[str], Meta(description="Of `fleet netem`; else none.")]
    no_return: NoReturn
    notes: list[str]


@dataclass(frozen=True, slots=True)
class Question:
    """The question to explain, and the way to do so."""

    path: Path
    check: str | None = None  # None: the first one that failed
    most_runs: int = 0  # healed ones; 0: none is made


OnProgress = Callable[[str, int], None]


class Explanation:
    def __init__(self, question: Question, on_progress: OnProgress) -> None:
        """Read the log, and make its run once more if that is possible. Raises LogReadError, FleetError, ScenarioError
        if the log cannot be explained; the text says why.
        """
        self._question, self._on_progress = question, on_progress
        self._notes: list[str] = []
        source = read_recorded_run(question.path, lambda share: on_progress(f"reading the log, {100 * share:.0f} %", 0))
        self.path = source.path
        self._why_not = _why_not(source, question)
        self.scenario = source.script(policy=Policy())
        result = _recorded_result(source.path)
        recorded_verdicts = [] if result is None else result.checks
        # Of nodes a log has packets alone, and the last one may have come long before the end of the run.
        self._ended_s = result.sim_s if result is not None and self.scenario.nodes else 0.0
        known = [*check_names([self.scenario]), *(one.check for one in recorded_verdicts)]
        if question.check is not None and question.check not in known:
            hint = nearest(question.check, known) or f"it has {', '.join(dict.fromkeys(known))}"
            raise FleetError(f"{source.path}: there is no check {question.check}; {hint}")
        if recorded_verdicts:
            _chosen(source.path, recorded_verdicts, question.check)  # before the run is made again
        self._differs, self._before = self._of_origin(source)
        self._remade = None if self._why_not else self._remake()
        if self._remade is not None and self._remade.broken:
            self._why_not, self._remade = f"the run breaks: {self._remade.broken}", None
        verdicts = recorded_verdicts if self._remade is None else self._remade.verdicts
        if not verdicts:
            why_not = f"{self._why_not}, and there is no result.json of it beside it"
            raise FleetError(f"{source.path}: there is no verdict to explain: {why_not}")
        self.verdict, self._others = _chosen(source.path, verdicts, question.check)
        before = next((one for one in recorded_verdicts if one.check == self.verdict.check), None)
        if before is not None and before.found != self.verdict.found:
            self._notes.append(f"when it was recorded, this was found: {before.found}; fleet verify says what differs")
        self.modules = modules_of([self.scenario], None)

    def find(self, engine: Engine, modules: Modules) -> Why:
        """Explain it. `engine`: makes the healed runs. `modules`: that they need, as the engine carries them. Raises
        StudyError if a healed run does not come to its end; LogReadError if the log cannot be read.
        """
        return self._explained(self._no_return(engine, modules))

    def without_runs(self) -> Why:
        why = self._why_not or "it was not looked for: --budget is 0"
        return self._explained(NoReturn("not possible", why))

    @property
    def searches(self) -> bool:
        return self._remade is not None and self._question.most_runs > 0

    def _remake(self) -> Rerun:
        return remake(self.scenario, lambda share: self._on_progress(f"the run once more, {100 * share:.0f} %", 0))

    def _of_origin(self, source: Recorded) -> tuple[list[str], list[Verdict]]:
        """Compare the scenario with that of the run that this one goes on from.

        Returns:
            The keys that differ, in words, and the verdicts of that run; nothing of any other run.
        """
        start = source.reader.metadata.get("run", {}).get(FROM, "")
        path, _, known = start.partition(", digest ")
        if not known:
            return [], []
        try:
            origin = read_recorded_run(Path(path))
            if digest(origin.path) != known:
                raise FleetError("it is another log by now")
        except FleetError as error:
            self._notes.append(f"it goes on from {path}, which cannot be compared: {error}")
            return [], []
        before, now = (_values(_tree(text)) for text in (origin.text, source.text))
        keys = [key for key in {**before, **now} if before.get(key) != now.get(key)]
        differs = [f"{key}: {_change(before.get(key), now.get(key))}" for key in keys]
        self._notes.append(f"it goes on from {path}, " + ("with changes" if differs else "with the same scenario"))
        result = _recorded_result(origin.path, known)
        verdicts = [] if result is None else result.checks
        if any(one.failed for one in verdicts):
            self._why_not += f"; fleet why {shlex.quote(str(origin.path))} explains the run that it goes on from"
        return differs, verdicts

    def _no_return(self, engine: Engine, modules: Modules) -> NoReturn:
        assert self._remade is not None
        search = HealingSearch(self._remade, self.verdict.check, engine, self._on_progress, modules)
        return search.run(self._question.most_runs)

    def _explained(self, found: NoReturn) -> Why:
        log = open_log(
            self.path,
            [*TOPICS, SAID],
            share=lambda share: self._on_progress(f"reading the log, {100 * share:.0f} %", 0),
        )
        begin, failed_s, failing = self._when(log)
        at_s = min(failed_s, self._end_s(log))
        own = bool(self.scenario.nodes) or any(control.agent is not None for control in self.scenario.controls)
        verdict = self.verdict
        moves = not self.scenario.spec.moored
        then = evidence(log, at_s, verdict.signals, failing, protocol=own, nodes=self.scenario.nodes, moves=moves)
        return Why(
            self.scenario.name, self.scenario.seed, verdict.check, verdict.asked, verdict.words, self._others,
            self._differs, next((one.passed for one in self._before if one.check == verdict.check), None), begin,
            failed_s, at_s, then.faults, then.sent, then.lost, then.gaps, then.vehicles, said_before(log, at_s),
            list(self.scenario.names), found, self._notes,
        )  # fmt: skip

    def _when(self, log: Log) -> tuple[float, float, list[int]]:
        """The last time when the check is known to have held, the time when it had failed [s], and who failed it."""
        failing: list[int] = []
        if self.verdict.moment is not None:
            begin = at_s = self.verdict.moment.at_s
            failing = self.verdict.moment.vehicles
        elif (older := self._older(log)) is not None:
            at_s, (_, dst) = older
            begin, failing = log.begin or at_s, [dst]  # what was heard before the log begins is not known
        elif self._remade is not None:
            begin, at_s = self._remade.failed_between(self.verdict.check)
        else:
            margin = self.verdict.margin  # its time is that of the worst value, not of the first beyond the limit
            begin, at_s = log.begin, log.end if margin is None or margin.at_s is None else margin.at_s
        if at_s > (end_s := self._end_s(log)):
            self._notes.append(f"the log ends at {end_s:g} s, before the check fails; this explains its end")
        return begin, at_s, failing

    def _older(self, log: Log) -> tuple[float, Link] | None:
        """When the check `max_age` failed first, and on which link; None: it is another check, or the log tells not."""
        asked = self.scenario.spec.checks.max_age
        if asked is None or self.verdict.check != "max_age":
            return None
        links = select(parse_selector(asked.links), self.scenario.graph.links)
        below_s, after_s = asked.below / 1e9, asked.after / 1e9
        nodes = bool(self.scenario.nodes)
        return first_older(log, links, below_s, after_s, self._end_s(log), from_first_packet=nodes)

    def _end_s(self, log: Log) -> float:
        """When the run of the log ended [s]."""
        return max(log.end, self._ended_s)


def _recorded_result(log: Path, known: str | None = None) -> Result | None:
    """The result beside a log. None: there is none, or it is of another log. `known`: the digest."""
    try:
        result = read_result(log.parent)
    except (FileNotFoundError, ResultError):
        return None
    return result if result.digest == (known or open_log(log, []).digest) else None


def _tree(text: str) -> Any:
    node, _ = read(Source("", text))
    return None if node is None else plain(node)


def _values(tree: Any, key: str = "") -> dict[str, Any]:
    """The values of a scenario by their keys; a list counts as one."""
    if not isinstance(tree, dict):
        return {key: tree}
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= _values(value, f"{key}.{name}" if key else str(name))
    return found


def _change(before: Any, now: Any) -> str:
    """How a value differs from what it was; of two lists only what one of them has alone."""
    if isinstance(before, list) and isinstance(now, list):
        alone = [[one for one in some if one not in others] for some, others in ((now, before), (before, now))]
        if any(alone):
            both = zip(("here", "there"), alone, strict=True)
            return "; ".join(f"{where} {inline(some)}" for where, some in both if some)
    here, there = ("not set" if value is None else inline(value) for value in (now, before))
    return f"{here}, there {there}"


def _why_not(source: Recorded, question: Question) -> str:
    external = source.script().external
    if external:
        vehicles = ", ".join(map(str, external))
        return f"the agent of vehicle {vehicles} is external, so no run can be made with it again"
    if source.script().nodes:
        return "its programs ran on the wall clock, so no run comes out the same again"
    if source.reader.metadata.get("run", {}).get(CLOCK) == Clock.REAL:
        return "it was recorded with --clock real, so no run comes out the same again"
    if source.goes_on:
        again = shlex.quote(str(source.path.parent / SCENARIO))
        return f"it goes on from another run, so it is not healed; fleet run {again} makes it from the start"
    return ""


def _chosen(path: Path, verdicts: Sequence[Verdict], check: str | None) -> tuple[Verdict, list[str]]:
    """The verdict to explain, and the other checks that failed. Raises FleetError."""
    failed = [one for one in verdicts if one.failed and one.check != "expect"]
    names = list(dict.fromkeys(one.check for one in failed))
    if not failed:
        raise FleetError(f"{path}: no check failed, so there is nothing to explain")
    if check is not None and check not in names:
        known = {one.check for one in verdicts}
        says = "passed" if check in known else "is none of this run"
        raise FleetError(f"{path}: the check {check} {says}; these failed: {', '.join(names)}")
    chosen = next(one for one in failed if check in (None, one.check))
    return chosen, [name for name in names if name != chosen.check]


_MOST_FAULTS, _MOST_GAPS, _MOST_VEHICLES, _MOST_LINKS, _MOST_HEARD, _MOST_DIFFER = 8, 8, 12, 6, 6, 8


def lines(why: Why) -> list[str]:
    return [*_verdict(why), "", *_changes(why), *_faults(why), "", *_messages(why), "", *_vehicles(why), "",
            *_said(why), "the point of no return", f"  {why.no_return.words}", *_after(why)]  # fmt: skip


def _verdict(why: Why) -> Iterator[str]:
    yield f"{why.scenario}, seed {why.seed}: {why.check} failed"
    yield f"  asked  {why.asked}"
    yield f"  found  {why.found}"
    if why.held_until_s < why.failed_s:
        yield f"  it held until {why.held_until_s:g} s, and had failed by {why.failed_s:g} s"
    else:
        yield f"  it failed at {why.failed_s:g} s"
    if why.others:
        yield f"  also failed: {', '.join(why.others)} (--check explains another one)"


def _changes(why: Why) -> Iterator[str]:
    if why.differs:
        there = {True: ", and this check passed there", False: ", and this check failed there, too", None: ""}
        yield f"changed since the run that it goes on from{there[why.origin_passed]}"
        yield from (f"  {line}" for line in why.differs[:_MOST_DIFFER])
        if len(why.differs) > _MOST_DIFFER:
            yield f"  and {len(why.differs) - _MOST_DIFFER} more (--json has them)"
        yield ""


def _faults(why: Why) -> Iterator[str]:
    if not why.faults:
        yield f"no fault had begun by {why.at_s:g} s"
        return
    yield "faults"
    room = table.shown_rows(len(why.faults), _MOST_FAULTS)
    shown = sorted(why.faults, key=lambda fault: (not fault.on, -fault.from_s))[:room]
    for fault in sorted(shown, key=lambda fault: fault.from_s):
        span = f"since {fault.from_s:g} s" if fault.on else f"{fault.from_s:g} to {fault.to_s:g} s"
        yield f"  {'on   ' if fault.on else 'over '}  {span}: {fault.what} ({fault.id})"
    if len(why.faults) > len(shown):
        yield f"  and {len(why.faults) - len(shown)} more, which were over"


def _messages(why: Why) -> Iterator[str]:
    lost = sum(why.lost.values())
    if lost:
        yield f"messages that had not arrived by {why.at_s:g} s: {lost} of {why.sent}"
    else:
        yield f"all {why.sent} messages arrived" if why.sent else "no message was sent"
    for cause, count in why.lost.items():
        yield f"  {count}  {cause}: {CAUSES.get(cause, cause)}"
    if why.gaps:
        yield "  the silences that explain most"
    for gap in why.gaps[:_MOST_GAPS]:
        yield f"    {_gap(gap, why)}"


def link_name(link: str, why: Why) -> str:
    """A link such as `1->2`, with the names of nodes if it has some."""
    return "->".join(why.nodes[int(i) - 1] if why.nodes else i for i in link.split("->"))


def name_of(i: int, why: Why) -> str:
    """A vehicle in words, or the name of a node."""
    return why.nodes[i - 1] if why.nodes else f"vehicle {i}"


def _gap(gap: Gap, why: Why) -> str:
    if gap.cause == NOT_SENT:
        span = f"after {gap.from_s:g} s" if gap.goes_on else f"between {gap.from_s:g} and {gap.to_s:g} s"
        return f"{name_of(int(gap.links[0].partition('->')[0]), why)} sent nothing {span}"
    links = [link_name(link, why) for link in gap.links]
    span = f"at {gap.from_s:g} s" if gap.from_s == gap.to_s else f"from {gap.from_s:g} to {gap.to_s:g} s"
    each = f"{gap.messages} message{'s' if gap.messages > 1 else ''}"
    on = ", and still so" if gap.goes_on else ""
    return f"{_some(links, _MOST_LINKS)} {span}: {each}, {gap.words}{on}"


def _vehicles(why: Why) -> Iterator[str]:
    yield f"what each {'node had heard' if why.nodes else 'vehicle knew'} at {why.at_s:g} s"
    room = table.shown_rows(len(why.vehicles), _MOST_VEHICLES)
    for vehicle in why.vehicles[:room]:
        yield from _vehicle(vehicle, why)
    if len(why.vehicles) > room:
        yield f"  and {len(why.vehicles) - room} more vehicles (--json has them)"


def _vehicle(then: VehicleThen, why: Why) -> Iterator[str]:
    begin = f"  {name_of(then.vehicle, why)}"
    if then.life > 1:
        begin += f" (life {then.life}, since {then.life_since_s:g} s; it began without memory)"
    if then.silent_s is not None:
        yield f"{begin}: had reported nothing for {then.silent_s:.3g} s"
        return
    if then.signals:
        yield f"{begin}: " + ", ".join(f"{name} {_number(value)}" for name, value in then.signals.items())
    else:
        yield f"{begin}:"
    if then.off_m is not None:
        sure = "" if then.sd_m is None else f", and took {then.sd_m:.2g} m for its error"
        yield f"    it was {then.off_m:.2g} m from where it believed to be{sure}"
    if then.heard:
        worst = sorted(then.heard, key=lambda one: (one.age_s is not None, -(one.age_s or 0.0)))
        yield f"    {_some([_heard(one, why) for one in worst], _MOST_HEARD, '; ')}"


def _said(why: Why) -> Iterator[str]:
    if why.said:
        yield f"what the programs had said last by {why.at_s:g} s"
        yield from (f"  {line.words(name_of(line.vehicle, why))}" for line in why.said)
        yield ""


def _heard(heard: Heard, why: Why) -> str:
    name = why.nodes[heard.vehicle - 1] if why.nodes else str(heard.vehicle)
    if heard.sent_s is None:
        return f"nothing from {name}"
    moved = "" if heard.moved_m is None else f", position {heard.moved_m:.2g} m off"
    return f"latest from {name}: sent at {heard.sent_s:g} s, {heard.age_s:.3g} s ago{moved}"


def _after(why: Why) -> Iterator[str]:
    for note in why.notes:
        yield f"  note: {note}"


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"


def _some(texts: Sequence[str], most: int, between: str = ", ") -> str:
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return between.join(texts[:most]) + more
