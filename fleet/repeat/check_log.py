"""`fleet check LOG`: a recorded run judged by checks of the user's own, as if they had been asked when it was made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, field

from fleet.checks.own_checks import OwnChecks, due_groups, logged_signals
from fleet.checks.values import LoggedValues, Values
from fleet.errors import FleetError, Problem, ScenarioError
from fleet.logs.decoder import Decoder
from fleet.logs.fault_intervals import fault_message
from fleet.logs.schemas import FAULT, FROM_TICK, PACKET, MessageField
from fleet.logs.topic_names import link_topic
from fleet.mcap.reader import LogReader, Record
from fleet.repeat.recorded_run import read_recorded_run
from fleet.result.verdict import Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signal_checks import SignalCheckError
from fleet.scenario.sections.timeline import Event
from fleet.scenario.text.overrides import Override
from fleet.scenario.trust import Policy
from netem.wire.messages import Fate

FAULTS = "faults"  # topic


class JudgedLog(Struct, frozen=True):
    """`fleet check LOG --json`: a log judged by checks."""

    path: Path = field(name="log")
    passed: bool
    until_s: Annotated[float, Meta(description="Judged up to then.")]
    end_s: float
    missing: Annotated[str, Meta(description="Empty: the file is whole.")]
    verdicts: list[Verdict] = field(name="checks")


def check_log(
    path: Path, overrides: Sequence[str] = (), reading: Callable[[float], None] = lambda share: None
) -> JudgedLog:
    """Judge a log by its scenario's own checks, or by others: `overrides` are `checks...=...` as for `fleet run --set`.
    `reading` gets the share of the file that was read, twice from its beginning. Raises FleetError if there is no log
    of ours, or nothing in it to judge; ScenarioError if it has no scenario for this version, or an override is wrong;
    CheckError or SignalCheckError if a check cannot be made, or makes no sense for this log.
    """
    _insist_on_checks(overrides)
    source = read_recorded_run(path, reading)
    refused: list[Problem] = []  # a law that may not run is no mistake here, unless a check is about one of its signals
    scenario = source.script([Override.of(text) for text in overrides], Policy(refused=refused))
    if strangers := [problem for problem in refused if problem.key.partition(".")[0] == "checks"]:
        raise ScenarioError(strangers)
    begin = source.reader.metadata.get("run", {}).get(FROM_TICK, "0")
    first = int(begin) if begin.isdecimal() else 0
    checks = _checks(scenario, first, refused)
    if checks is None:
        raise FleetError(
            f"{source.path}: nothing to judge: its scenario has no check on a signal and none in Python; its others "
            "were judged by the run. Give one, as in --set 'checks={signal: {topic: state.z, below: 30 m}}'"
        )
    if overrides and (others := _not_judged(scenario, source.script())):
        problem = "a log is judged by checks on signals and in Python only, and this one needs a run"
        raise FleetError(f"--set checks.{others[0]}: {problem}; fleet run --set has the same words")
    for event in scenario.faults.events:
        if event.tick < first:  # the run went on from another, whose log does not have this event
            checks.event(event)
    feed = _Feed(scenario, checks, first)
    reader = LogReader(source.path, reading)
    feed.read(reader, None if source.reader.missing else source.last_ns // scenario.tick_ns)
    if feed.newest < 0:
        raise FleetError(f"{source.path} holds no sample to judge{f': {reader.missing}' if reader.missing else ''}")
    complete = not reader.missing and feed.newest == scenario.ticks
    verdicts = checks.verdicts(over=complete)
    return JudgedLog(
        source.path,
        all(verdict.passed for verdict in verdicts),
        feed.newest * scenario.tick_ns / 1e9,
        scenario.duration_ns / 1e9,
        reader.missing,
        verdicts,
    )


def _insist_on_checks(overrides: Sequence[str]) -> None:
    for text in overrides:
        if (key := text.partition("=")[0].strip()).partition(".")[0] != "checks":
            hint = f"another run is fleet run --set {key}"
            raise FleetError(f"--set {key}: a log can be judged by other checks, and by nothing else; {hint}")


def _checks(scenario: Scenario, first: int, refused: Sequence[Problem]) -> OwnChecks | None:
    try:
        return OwnChecks.from_scenario(scenario, first)
    except SignalCheckError as error:
        if not refused or error.key not in ("topic", "vehicles"):
            raise
        law = refused[0]
        why = "; ".join(filter(None, (law.message.removeprefix(f"{law.key}: "), law.hint)))
        hint = f"what laws and plants of this log report is not known here, because of {why}"
        raise SignalCheckError(error.key, error.problem, hint) from None


def _not_judged(asked: Scenario, recorded: Scenario) -> list[str]:
    now, before = (one.spec.checks.model_dump(exclude={"signal", "python"}) for one in (asked, recorded))
    return [key for key, check in now.items() if ":" not in key and check is not None and check != before.get(key)]


class _Feed:
    """Shows checks what a log holds, in its order: the faults of a tick, its values, and its fates."""

    def __init__(self, scenario: Scenario, checks: OwnChecks, first: int) -> None:
        self._scenario = scenario
        self._checks, self._tick_ns, self._end = checks, scenario.tick_ns, scenario.ticks + 1
        self._links = {link_topic(link): link for link in scenario.graph.links}
        self._samples = {
            f"uuv/{i}/{group}": (i, group, signals)
            for i in range(1, scenario.vehicles + 1)
            for group, signals in logged_signals(scenario, i).groups().items()
            if group in checks.groups
        }
        self._columns = {FAULTS: FAULT, **dict.fromkeys(self._links, PACKET)} | {
            topic: tuple(MessageField(each.name, "", "", 0 if each.width == 1 else each.width) for each in of[2][1])
            for topic, of in self._samples.items()
        }
        self._found: dict[tuple[int, str], Values] = {}  # values at the tick that is read
        self._tick = -1
        self._whole = False
        self._next = first  # tick up to before which everything is shown
        self.newest = -1  # tick that was judged

    def read(self, reader: LogReader, last: int | None) -> None:
        """Show all of a log. `last`: the last tick of a whole log. If a tick lacks a sample, the vehicle reported
        nothing. None: the log is not whole. A missing sample may then be lost, and the last tick is left out.
        """
        self._whole = last is not None
        decode = Decoder(reader).ours
        for record in reader.of({FAULTS, *self._links, *self._samples}):
            lacking = record.topic in self._samples
            if (message := decode(record, self._columns[record.topic], lacking=lacking)) is None:  # damaged
                continue
            if record.topic in self._samples:
                self._sample(record, message)
            elif record.topic in self._links:
                self._show()
                self._show_silence(record.log_ns // self._tick_ns + 1)
                self._checks.settle(self._fate(record, message))
            else:
                self._show()
                tick = record.log_ns // self._tick_ns
                self._show_silence(tick)
                if (told := fault_message(message, self._scenario.nodes)) is not None:
                    self._checks.event(Event(tick, *told))
        if last is not None:
            self._show()
            self._show_silence(last + 1)

    def _sample(self, record: Record, message: Any) -> None:
        tick = record.log_ns // self._tick_ns
        if tick != self._tick:
            self._show()
            self._show_silence(tick)
            self._tick = tick
        i, group, (start, signals) = self._samples[record.topic]
        values: list[float] = [nan] * start
        for signal in signals:
            value = getattr(message, signal.name, None)  # a log of another version may lack it
            missing = [nan] * signal.width
            numbers = missing if value is None else [value] if signal.width == 1 else [*value]
            values += numbers if len(numbers) == signal.width else missing
        self._found[i, group] = tuple(values)

    def _show(self) -> None:
        if not self._found:
            return
        self._take(self._tick, self._found)
        self._found = {}

    def _show_silence(self, until: int) -> None:
        """Show the ticks before this one at which a sample is due and the log has none.

        A run shows them to its checks, too.
        """
        for tick in range(self._next, min(until, self._end)) if self._whole else ():
            if due_groups(self._scenario, tick):
                self._take(tick, {})

    def _take(self, tick: int, found: dict[tuple[int, str], Values]) -> None:
        self._checks.take(LoggedValues(tick, found))
        self.newest, self._next = tick, tick + 1

    def _fate(self, record: Record, message: Any) -> Fate:
        src, dst = self._links[record.topic]
        return Fate(
            final_tick=record.log_ns // self._tick_ns,
            src=src,
            dst=dst,
            seq=message.seq,
            copy=message.copy,
            sent_tick=record.publish_ns // self._tick_ns,
            due_tick=round(message.due * 1e9 / self._tick_ns),
            delay_ns=round(message.delay * 1e9),
            cause=message.fate,
            corrupted=message.corrupted,
            payload=message.payload,
        )
