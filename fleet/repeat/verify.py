"""`fleet verify`: run a log again, in this process, and compare message by message while it runs.

A log is written in one order. So the log of a run that was stopped, broke or was killed is the beginning of the
complete log. All its messages must come again, in this order. Nothing is held but the message at hand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from msgspec import Meta, MsgspecError, Struct, convert, json
from msgspec import field as entry

from fleet.cores import machine
from fleet.errors import FleetError
from fleet.execution.clock import GrantPolicy
from fleet.execution.external_agents import describe_external
from fleet.execution.in_process import start_in_process
from fleet.execution.moments import reach
from fleet.logs.decoder import Decoder
from fleet.logs.difference import Difference, Side, difference, side
from fleet.logs.schemas import (
    FROM,
    OLD_START,
    SNAPSHOTS,
    START,
    Schema,
)
from fleet.mcap.batch import Batch
from fleet.mcap.reader import GAPS, RECOVERY, LogReader, Record
from fleet.recorder.start import Leg, Start
from fleet.recorder.writer import LogWriter, run_metadata
from fleet.repeat.recorded_agent import NotRecordedError, recorded_agents
from fleet.repeat.recorded_run import Recorded, read_recorded_run
from fleet.result.file import ResultError, read_result
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.trust import Policy, ran_from

_VERSIONS = ("uuv-fleet", "python", "piqp")  # other versions may change a bit without a mistake


class Verification(Struct):
    """`fleet verify --json`: how far a log was reproduced."""

    path: Path = entry(name="log")
    until_s: Annotated[float, Meta(description="Of the last recorded message.")]
    end_s: float
    reproduced: Annotated[bool, Meta(description="Whether everything that was compared is the same.")] = False
    messages: int = 0
    missing: Annotated[str, Meta(description="Empty: the file is whole.")] = ""
    skipped: Annotated[int, Meta(description="Messages that the re-run gave where the file has gaps.")] = 0
    difference: Annotated[Difference | None, Meta(description="null: there is none.")] = None
    reason: Annotated[str, Meta(description="Why the re-run ended early; empty: it did not.")] = ""
    contradictions: Annotated[list[str], Meta(description="Between the log's metadata and its scenario.")] = []
    versions: Annotated[list[str], Meta(description="Those that are not as they were when it was recorded.")] = []
    machine: Annotated[
        str, Meta(description="This one and the recording one, if they differ or that is not known.")
    ] = ""
    external: Annotated[tuple[int, ...], Meta(description="Vehicles whose commands were taken from the log.")] = ()
    unknown: Annotated[str, Meta(description="Why nothing more could be compared; empty: everything was.")] = ""


OnProgress = Callable[
    [float, float], None
]  # sim time that is verified, and up to which there is something to verify [s]


def verify(
    path: Path,
    on_progress: OnProgress = lambda at_s, end_s: None,
    reading: Callable[[float], None] = lambda share: None,
) -> Verification:
    """Run a log again and compare. Raises LogReadError if there is no log to read; FleetError if it holds no scenario
    of ours, or no message; ScenarioError if its scenario does not run here: another version wrote it, or a law is not
    installed and not trusted; NotRecordedError if it lacks commands of an external agent.
    """
    source = read_recorded_run(path, reading)
    path, reader, last_ns = source.path, source.reader, source.last_ns
    source.insist_on_lockstep(
        "it does not come out the same again", "fleet regress tells how often kept failures come again"
    )
    if last_ns < 0:
        raise FleetError(f"{path} holds no message{f': {reader.missing}' if reader.missing else ''}", status=3)
    start, scenario = start_of(source), as_it_was(source)
    verification = Verification(path, last_ns / 1e9, scenario.ticks * scenario.tick_ns / 1e9, missing=reader.missing)
    verification.external = scenario.external
    _compare_metadata(verification, reader.metadata.get("run", {}), run_metadata(scenario, start))
    comparison = _Comparison(verification, scenario, reader, last_ns, on_progress)
    _run_again(comparison, verification, scenario, last_ns, start)
    verification.machine = _machines(path)
    verification.reproduced = verification.difference is None and not verification.contradictions
    return verification


def as_it_was(source: Recorded) -> Scenario:
    """The scenario to run: the log's if the faults happened as planned, else one with the actual faults."""
    policy = _policy(source.text)
    if source.goes_on:
        return source.script(policy=policy)
    scenario = parse_scenario(source.text, str(source.path), policy=policy)
    happened = [(at_ns, e.fault, e.action, e.what) for at_ns, e in source.events]
    planned = [(e.tick * scenario.tick_ns, e.fault, e.action, e.what) for e in scenario.faults.events]
    kept = set(happened)
    # A file with gaps may lack some messages, and a cut one what belongs to its last tick.
    gone = [event for event in planned if event[0] < source.last_ns and event not in kept]
    if kept <= set(planned) and (not gone or _gaps(source.reader)):
        return scenario
    return source.script(policy=policy)


def _policy(text: str) -> Policy:
    return Policy(checks=False, own=ran_from(text))


def start_of(source: Recorded) -> Start | None:
    """Where the run of a log began, if it went on from another.

    Raises:
        FleetError: the log does not say that to this version.
        ScenarioError: what was run before does not run here.
    """
    if not source.goes_on:
        return None
    run, attached = source.reader.metadata["run"], source.reader.attachments
    if START not in attached:
        why = "a snapshot, which this version does not read" if OLD_START in attached else "what the file has lost"
        raise FleetError(f"{source.path} goes on from {why}; run it anew from {run[FROM]}: fleet run --from")
    try:
        legs = convert(json.decode(attached[START]), list[tuple[str, int]])
    except MsgspecError as error:
        raise FleetError(f"{source.path}: where its run begins ({START}) is damaged: {error}") from None
    where = f"{source.path}, {START}"
    return Start(tuple(Leg(parse_scenario(text, where, policy=_policy(text)), k) for text, k in legs), run[FROM])


def _gaps(reader: LogReader) -> list[int]:
    numbers = reader.metadata.get(RECOVERY, {}).get(GAPS, "").split()
    return [int(number) for number in numbers if number.isdecimal()]


def _compare_metadata(verification: Verification, recorded: dict[str, str], here: dict[str, str]) -> None:
    for key in [*here, *(key for key in recorded if key not in here)]:
        left, right = recorded.get(key), here.get(key)
        if left == right:
            continue
        if key in _VERSIONS or key == "resumable" or key.startswith(("law ", "plant ")):
            short = [value[:20] if value else "unknown" for value in (left, right)]
            verification.versions.append(f"{key}: recorded with {short[0]}, here is {short[1]}")
        else:
            verification.contradictions.append(f"metadata {key}: {left}, but its scenario says {right}")


def _machines(path: Path) -> str:
    """The machine that recorded a log, and this one. Empty: both are of one kind. The result beside the log names it;
    if the log did, its bytes would differ from machine to machine.
    """
    here, there = machine(), ""
    with suppress(OSError, ResultError):
        there = read_result(path.parent).wall.machine
    return (
        ""
        if there == here
        else f"recorded on {there or 'a machine that no result beside the log names'}, here is {here}"
    )


class _Over(Exception):
    """Everything that was recorded has been compared, or the two differ."""


class _Comparison:
    """A sink of the log writer that compares each message with the recorded one, and writes nothing."""

    def __init__(
        self, verification: Verification, scenario: Scenario, reader: LogReader, last_ns: int, on_progress: OnProgress
    ) -> None:
        self._verification, self._on_progress = verification, on_progress
        self._tick_ns, self._last_ns = scenario.tick_ns, last_ns
        self._first = reader
        self._complete = not reader.missing and last_ns == scenario.ticks * scenario.tick_ns
        self.external = recorded_agents(LogReader(verification.path), scenario, last_ns, whole=self._complete)
        self._again = LogReader(verification.path)
        self._recorded: Iterator[Record] = iter(self._again)
        self._gaps = deque(_gaps(reader))
        self._number = -1  # number of the recorded message at hand
        self._expected = self._next()
        self._topics: list[str] = []
        self._reported_ns = 0

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Nothing to compare: the attachments of the log are what is run again."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Nothing to compare: `_compare_metadata` has done so."""

    def channel(self, topic: str, schema: Schema) -> int:
        self._topics.append(topic)
        return len(self._topics) - 1

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        here = Record(self._topics[channel], log_ns, publish_ns, sequence, data)
        expected = self._expected
        if expected is None and not self._complete:
            raise _Over
        if expected != here:
            if self._gaps and self._number >= self._gaps[0] and expected is not None and expected[:4] != here[:4]:
                self._verification.skipped += 1
                return
            self._differ(here)
            self._forgive(log_ns if expected is None else min(log_ns, expected.log_ns))
            raise _Over
        while self._gaps and self._gaps[0] <= self._number:
            self._gaps.popleft()
        self._verification.messages += 1
        self._expected = self._next()
        if self._expected is None and not self._complete:
            raise _Over

    def way(self, start: Start) -> Callable[[float], None]:
        """Tells how far it is to where the log begins."""
        begin_s, end_s = start.tick * self._tick_ns / 1e9, self._last_ns / 1e9
        return lambda share: self._on_progress(share * begin_s, end_s)

    def _next(self) -> Record | None:
        """The next recorded message, without the snapshots of older versions."""
        for record in self._recorded:
            self._number += 1
            if record.topic != SNAPSHOTS:
                return record
        self._number += 1
        return None

    def batch(self, batch: Batch) -> None:
        for message in batch.messages():
            self.message(*message)

    def flush(self, at_ns: int) -> None:
        if at_ns > self._reported_ns:
            self._reported_ns = at_ns
            self._on_progress(at_ns / 1e9, self._last_ns / 1e9)

    def finish(self) -> None:
        """The run has ended: a recorded message that did not come again is a difference."""
        verification = self._verification
        if verification.difference is None and self._expected is not None and not verification.unknown:
            self._differ(None)

    def _forgive(self, at_ns: int) -> None:
        """A difference means nothing when what an external agent had sent by then is not in the log."""
        for i, agent in self.external.items():
            if at_ns > agent.known * self._tick_ns:
                self._verification.difference = None
                since = agent.known * self._tick_ns / 1e9
                self._verification.unknown = (
                    f"what vehicle {i} sent after t = {since:g} s was under way when the log ended, and is not in it"
                )

    def _differ(self, here: Record | None) -> None:
        recorded = side("recorded", self._again, self._expected)
        if here is not None:
            # By the log's own declarations, which it has of every topic that it shares with the re-run.
            right = Side("re-run", here, Decoder(self._first)(here), self._tick_ns)
        else:
            right = Side("re-run", None, [], self._tick_ns, self._verification.reason)
        self._verification.difference = difference(self._number, recorded, right)


class Proof(_Comparison):
    """A sink of the log writer that insists on the messages of a log, as far as they go."""

    def __init__(self, source: Recorded, scenario: Scenario, before: Start | None) -> None:
        self._path, self._about = source.path, source.reader.metadata.get("run", {})
        found = Verification(source.path, source.last_ns / 1e9, scenario.duration_ns / 1e9)
        _compare_metadata(found, self._about, run_metadata(scenario, before))
        super().__init__(found, scenario, source.reader, source.last_ns, lambda at_s, end_s: None)

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Compare it. Raises FleetError: the log has another one."""
        try:
            super().message(channel, log_ns, publish_ns, sequence, data)
        except _Over:
            found = self._verification
            if found.difference is None:
                return  # the log ends here
            likely = "".join(f"\nlikely why: {text}" for text in found.versions)
            raise FleetError(
                f"nothing can go on from {self._path}: its run does not come out the same again\n"
                f"{found.difference.words}{likely}\n"
                f"a run with what is here now: fleet run {self._path.with_name('scenario.yaml')}"
            ) from None


def _run_again(
    comparison: _Comparison, verification: Verification, scenario: Scenario, last_ns: int, start: Start | None
) -> None:
    tick = last_ns // scenario.tick_ns
    # No further than the recording went: it may have ended because the next tick cannot be computed.
    every, m = frame_every(scenario), scenario.round_ticks
    until = min(scenario.ticks, max(-(-tick // every) * every, -(-tick // m) * m) + 1)
    policy = GrantPolicy(until, scenario.tick_ns, m, every)
    agents = {i: agent.loop for i, agent in comparison.external.items()}
    moment = None if start is None else reach(start, comparison.way(start))
    before, links = (None, None) if moment is None else moment
    writer = LogWriter(comparison, scenario, start, links=links)
    runner = start_in_process(scenario, writer, before, agents=agents, judged=False)
    journal, seen = runner.journal, -2

    def moved() -> None:
        nonlocal seen
        if until < scenario.ticks and journal.written == seen:  # every grant is used up
            raise _Over
        seen = journal.written

    try:
        if (broken := runner.to_end(moved, policy)) is not None:
            verification.reason = broken.reason
    except _Over:
        pass
    except NotRecordedError as error:
        verification.unknown = str(error)
        return
    comparison.finish()


def verification_lines(verification: Verification) -> list[str]:
    lines = [
        f"{describe_external([i])}: its commands and payloads were taken from the log" for i in verification.external
    ]
    how_far = f"up to t = {verification.until_s:g} s"
    if verification.missing:
        how_far += f" of {verification.end_s:g} s, as far as the file goes: {verification.missing}"
    elif verification.until_s < verification.end_s:
        how_far += f" of {verification.end_s:g} s, where the run was ended"
    if verification.unknown:
        lines.append(
            f"reproduced bit for bit ({verification.messages} messages), and no further: {verification.unknown}"
        )
    elif verification.difference is None:
        if verification.messages:
            lines.append(f"reproduced bit for bit ({verification.messages} messages), {how_far}")
        if verification.skipped:
            lines.append(f"{verification.skipped} messages are missing in the file and were not compared")
    else:
        lines.append(f"NOT reproduced: {verification.messages} messages are the same, then")
        lines += verification.difference.words.splitlines()
        if verification.reason and verification.difference.b is not None:
            lines.append(f"the re-run ended: {verification.reason}")
        lines += [f"likely why: {text}" for text in verification.versions]
        lines += [f"machine: {verification.machine}"] * bool(verification.machine)
    lines += [f"contradiction: {text}" for text in verification.contradictions]
    return lines
