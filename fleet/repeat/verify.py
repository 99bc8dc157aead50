"""`fleet verify`: run a log again, in this process, and compare message by message while it runs.

A log is written in one order. So the log of a run that was stopped, broke or was killed is the beginning of the
complete log. All its messages must come again, in this order. Nothing is held but the message at hand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct, field

from agents.errors import AgentError
from fleet.errors import FleetError, RunBroken
from fleet.execution.clock import GrantPolicy
from fleet.execution.external_agents import named
from fleet.execution.in_process import InProcess
from fleet.logs.batch import Batch
from fleet.logs.decoder import Decoder
from fleet.logs.first_difference import Difference, Side, difference, side
from fleet.logs.reader import GAPS, RECOVERY, LogReader, Record
from fleet.logs.schemas import Schema
from fleet.recorder.journal import Journal
from fleet.recorder.snapshot import Start
from fleet.recorder.writer import LogWriter, run_metadata
from fleet.repeat.recorded_agent import NotRecordedError, recorded_agents
from fleet.repeat.recorded_run import Recorded, recorded
from fleet.repeat.resume import start_of
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.trust import Policy
from world.errors import WorldError

_VERSIONS = ("uuv-fleet", "python", "piqp")  # that may change a bit without anybody's mistake


class Verification(Struct):
    """`fleet verify --json`: how far a log was reproduced."""

    path: Path = field(name="log")
    until_s: Annotated[float, Meta(description="Simulated time of the last recorded message.")]
    end_s: float
    reproduced: Annotated[bool, Meta(description="Whether everything that was compared is the same.")] = False
    messages: int = 0
    missing: Annotated[str, Meta(description="Missing parts of the file; empty: it is whole.")] = ""
    skipped: Annotated[int, Meta(description="Messages that the re-run gave where the file has gaps.")] = 0
    difference: Annotated[Difference | None, Meta(description="The first difference; null: there is none.")] = None
    reason: Annotated[str, Meta(description="Why the re-run ended early; empty: it did not.")] = ""
    contradictions: Annotated[list[str], Meta(description="Between the log's metadata and its scenario.")] = []
    versions: Annotated[list[str], Meta(description="Those that are not as they were when it was recorded.")] = []
    external: Annotated[tuple[int, ...], Meta(description="Vehicles whose commands were taken from the log.")] = ()
    unknown: Annotated[str, Meta(description="Why nothing more could be compared; empty: everything was.")] = ""


Tell = Callable[[float, float], None]  # sim time that is verified, and up to which there is something to verify [s]


def verify(
    path: Path,
    tell: Tell = lambda at_s, end_s: None,
    reading: Callable[[float], None] = lambda share: None,
) -> Verification:
    """Run a log again and compare.

    Args:

    Raises:
        LogReadError: there is no log to read.
        FleetError: it holds no scenario of ours; no message of it is left.
        ScenarioError: its scenario does not run here, because another version wrote it, or because a law is not
            installed and not trusted.
        NotRecordedError: it has an external agent, but not all of its commands.
    """
    source = recorded(path, reading)
    path, reader, last_ns = source.path, source.reader, source.last_ns
    source.insist_on_lockstep("it does not come out the same again")
    if last_ns < 0:
        raise FleetError(f"{path} holds no message{f': {reader.missing}' if reader.missing else ''}", status=3)
    start = start_of(reader)
    policy = Policy(checks=False)
    scenario = source.script(policy=policy) if start is not None else _scenario(source, policy)
    verification = Verification(path, last_ns / 1e9, scenario.ticks * scenario.tick_ns / 1e9, missing=reader.missing)
    verification.external = scenario.external
    _compare_metadata(verification, reader.metadata.get("run", {}), run_metadata(scenario, start))
    comparison = _Comparison(verification, scenario, reader, last_ns, tell)
    _run_again(comparison, verification, scenario, last_ns, start)
    verification.reproduced = verification.difference is None and not verification.contradictions
    return verification


def _scenario(source: Recorded, policy: Policy) -> Scenario:
    """The scenario to run: the log's if the faults happened as planned, else one with the actual faults."""
    scenario = parse_scenario(source.text, str(source.path), policy=policy)
    happened = [(at_ns, e.fault, e.action, e.what) for at_ns, e in source.events]
    planned = [(e.tick * scenario.tick_ns, e.fault, e.action, e.what) for e in scenario.faults.events]
    kept = set(happened)
    # Of a file with gaps some of it may be missing, and of a cut one what belongs to its last tick.
    gone = [event for event in planned if event[0] < source.last_ns and event not in kept]
    if kept <= set(planned) and (not gone or _gaps(source.reader)):
        return scenario
    return source.script(policy=policy)


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


class _Over(Exception):
    """Everything that was recorded has been compared, or the two differ."""


class _Comparison:
    """A sink of the log writer that compares each message with the recorded one, and writes nothing."""

    def __init__(
        self,
        verification: Verification,
        scenario: Scenario,
        reader: LogReader,
        last_ns: int,
        tell: Tell,
    ) -> None:
        """Read what external agents sent.

        Args:
            verification: is filled in.
            reader: of the log, read to its end.
            last_ns: time of the last recorded message.
            tell: receives how far the comparison has come.

        Raises:
            NotRecordedError: the log does not hold all commands of an external agent.
        """
        self._verification, self._tell = verification, tell
        self._tick_ns, self._last_ns = scenario.tick_ns, last_ns
        self._first = reader
        self._complete = not reader.missing and last_ns == scenario.ticks * scenario.tick_ns
        self.external = recorded_agents(LogReader(verification.path), scenario, last_ns, whole=self._complete)
        self._again = LogReader(verification.path)
        self._recorded: Iterator[Record] = iter(self._again)
        self._expected = next(self._recorded, None)
        self._gaps = deque(_gaps(reader))
        self._number = 0  # of the recorded message at hand
        self._topics: list[str] = []
        self._reported_ns = 0

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Nothing to compare: the attachments of the log are what is run again."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Nothing to compare: `_compare_metadata` has done so."""

    def channel(self, topic: str, schema: Schema) -> int:
        """Number a topic."""
        self._topics.append(topic)
        return len(self._topics) - 1

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Compare a message with the recorded one.

        Raises:
            _Over: it differs, or was the last one.
        """
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
        self._number += 1
        self._expected = next(self._recorded, None)
        if self._expected is None and not self._complete:
            raise _Over

    def batch(self, batch: Batch) -> None:
        """Compare messages that have their times in common. Raises _Over as `message` does."""
        for message in batch.messages():
            self.message(*message)

    def flush(self, at_ns: int) -> None:
        """Report how far the comparison has come."""
        if at_ns > self._reported_ns:
            self._reported_ns = at_ns
            self._tell(at_ns / 1e9, self._last_ns / 1e9)

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


def _run_again(
    comparison: _Comparison, verification: Verification, scenario: Scenario, last_ns: int, start: Start | None
) -> None:
    """Run until everything is compared."""
    tick = last_ns // scenario.tick_ns
    journal = Journal(scenario, LogWriter(comparison, scenario, start))
    # No further than the recording went: it may have ended because the next tick cannot be computed.
    every, m = frame_every(scenario), scenario.round_ticks
    until = min(scenario.ticks, max(-(-tick // every) * every, -(-tick // m) * m) + 1)
    policy = GrantPolicy(until, scenario.tick_ns, m, every)
    seen = -2

    def moved() -> None:
        nonlocal seen
        if until < scenario.ticks and journal.written == seen:  # every grant is used up
            raise _Over
        seen = journal.written

    try:
        agents = {i: agent.loop for i, agent in comparison.external.items()}
        InProcess(scenario, journal, start, agents).serve(policy, moved)
    except _Over:
        pass
    except NotRecordedError as error:
        verification.unknown = str(error)
        return
    except RunBroken as error:
        verification.reason = error.reason
    except (AgentError, WorldError) as error:
        verification.reason = str(error)
    comparison.finish()


def verification_lines(verification: Verification) -> list[str]:
    """A verification in words."""
    lines = [f"{named([i])}: its commands and payloads were taken from the log" for i in verification.external]
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
    lines += [f"contradiction: {text}" for text in verification.contradictions]
    return lines
