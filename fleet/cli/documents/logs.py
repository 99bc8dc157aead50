"""The output with `--json` of the commands that read logs: verify, diff and info."""

from __future__ import annotations

from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct, convert

from fleet.cli.documents.live import EventCount
from fleet.logs.decoder import FieldValue
from fleet.logs.deviation import Difference, LogComparison, Side, same
from fleet.logs.info import Info
from fleet.repeat.check_log import JudgedLog
from fleet.repeat.verify import Verification
from fleet.result.verdict import Verdict

Missing = Annotated[str, Meta(description="Missing parts of the file; empty: it is whole.")]
Plain = str | int | float | bool | None


class MessageRow(Struct):
    """One message of a log."""

    topic: Annotated[str, Meta(description="Its topic.")]
    at_s: Annotated[float, Meta(description="When it happened [s].")]
    sent_s: Annotated[float, Meta(description="When it was sent [s].")]
    sequence: Annotated[int, Meta(description="Tick, or number of the packet.")]


class FieldRow(Struct):
    """One field of a message that is not the same."""

    field: Annotated[str, Meta(description="Its name.")]
    unit: Annotated[str, Meta(description="Its unit; empty: none.")]
    a: Annotated[Plain, Meta(description="Value in the first log, or as recorded; null: none, or not finite.")]
    b: Annotated[Plain, Meta(description="Value in the second log, or of the re-run; null: none, or not finite.")]


class FirstDifference(Struct):
    """The first message that differs between two logs."""

    number: Annotated[int, Meta(description="How many messages are before it.")]
    a: Annotated[MessageRow | None, Meta(description="In the first log, or as recorded; null: it has ended.")]
    b: Annotated[MessageRow | None, Meta(description="In the second log, or of the re-run; null: it has ended.")]
    fields: Annotated[list[FieldRow], Meta(description="Those that are not the same; bytes in hexadecimal.")]


class Verified(Struct):
    """`fleet verify --json`: how far a log was reproduced."""

    log: Annotated[str, Meta(description="Path of the log.")]
    reproduced: Annotated[bool, Meta(description="Whether everything that was compared is the same.")]
    messages: Annotated[int, Meta(description="Messages reproduced bit for bit.")]
    until_s: Annotated[float, Meta(description="Simulated time of the last recorded message [s].")]
    end_s: Annotated[float, Meta(description="Planned end of the run in simulated time [s].")]
    missing: Missing
    skipped: Annotated[int, Meta(description="Messages that the re-run gave where the file has gaps.")]
    difference: Annotated[FirstDifference | None, Meta(description="The first difference; null: there is none.")]
    reason: Annotated[str, Meta(description="Why the re-run ended early; empty: it did not.")]
    contradictions: Annotated[list[str], Meta(description="Between the log's metadata and its scenario.")]
    versions: Annotated[list[str], Meta(description="Those that are not as they were when it was recorded.")]
    external: Annotated[list[int], Meta(description="Vehicles whose commands were taken from the log.")]
    unknown: Annotated[str, Meta(description="Why nothing more could be compared; empty: everything was.")]


class SignalRow(Struct):
    """A signal that is not the same in two logs."""

    signal: Annotated[str, Meta(description="Topic and field.")]
    unit: Annotated[str, Meta(description="Its unit; empty: none.")]
    most: Annotated[float | None, Meta(description="Greatest |a - b|; null: it is not finite.")]
    at_s: Annotated[float, Meta(description="When that is [s].")]
    messages: Annotated[int, Meta(description="Messages in which it is not the same.")]


class Compared(Struct):
    """`fleet diff --json`: what two logs have in common and what not."""

    a: Annotated[str, Meta(description="Path of the first log.")]
    b: Annotated[str, Meta(description="Path of the second log.")]
    same: Annotated[bool, Meta(description="Whether all messages are the same, bit for bit.")]
    from_s: Annotated[float, Meta(description="Compared from then on: where a run goes on from another [s]; else 0.")]
    tolerance: Annotated[float, Meta(description="The most that two numbers may be apart.")]
    within: Annotated[bool, Meta(description="Whether all messages are there in both and within the tolerance.")]
    missing_a: Missing
    missing_b: Missing
    messages_same: Annotated[int, Meta(description="Messages that are the same, bit for bit.")]
    messages_differing: Annotated[int, Meta(description="Messages that are there in both and not the same.")]
    first: Annotated[FirstDifference | None, Meta(description="Where they part; null: they do not.")]
    signals: Annotated[list[SignalRow], Meta(description="All signals that are not the same, the greatest first.")]
    others: Annotated[
        dict[str, int], Meta(description="Messages with other texts, flags or bytes, by topic and field.")
    ]
    only_a: Annotated[dict[str, int], Meta(description="Messages that only the first log has, by topic.")]
    only_b: Annotated[dict[str, int], Meta(description="Messages that only the second log has, by topic.")]
    besides: Annotated[list[str], Meta(description="Metadata, attachments and declarations that are not the same.")]


class FaultTime(Struct):
    """A fault of a log."""

    id: Annotated[str, Meta(description="Its id.")]
    from_s: Annotated[float, Meta(description="When it began [s].")]
    to_s: Annotated[float, Meta(description="When it ended, at the latest with the log [s].")]
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]


class LogContents(Struct):
    """`fleet info --json`: the content of a log at a glance."""

    path: Annotated[str, Meta(description="Path of the log.")]
    bytes: Annotated[int, Meta(description="Its size [bytes].")]
    messages: Annotated[int, Meta(description="Number of messages.")]
    start_s: Annotated[float, Meta(description="Time of the first message [s].")]
    end_s: Annotated[float, Meta(description="Time of the last message [s].")]
    run: Annotated[dict[str, str], Meta(description="All that determines the run; empty: it is no log of a run.")]
    faults: Annotated[list[FaultTime], Meta(description="In the order in which they began.")]
    events: Annotated[list[EventCount], Meta(description="What happened to vehicles, one row for each.")]
    topics: Annotated[dict[str, tuple[str, int]], Meta(description="Schema and number of messages, by topic.")]
    missing: Missing
    unread: Annotated[int, Meta(description="Messages about faults that are left out above, as there are too many.")]


class LogJudged(Struct):
    """`fleet check-log --json`: a log judged by checks."""

    log: Annotated[str, Meta(description="Path of the log.")]
    passed: Annotated[bool, Meta(description="Whether every check passed.")]
    until_s: Annotated[float, Meta(description="Simulated time up to which it was judged [s].")]
    end_s: Annotated[float, Meta(description="Planned end of the run in simulated time [s].")]
    missing: Missing
    checks: Annotated[list[Verdict], Meta(description="The verdicts.")]


def judged(found: JudgedLog) -> LogJudged:
    """The document of a log that was judged."""
    return LogJudged(
        log=str(found.path),
        passed=found.passed,
        until_s=found.until_s,
        end_s=found.end_s,
        missing=found.missing,
        checks=found.verdicts,
    )


def verified(found: Verification) -> Verified:
    """The document of a verification."""
    return Verified(
        log=str(found.path),
        reproduced=found.reproduced,
        messages=found.messages,
        until_s=found.until_s,
        end_s=found.end_s,
        missing=found.missing,
        skipped=found.skipped,
        difference=None if found.difference is None else _difference(found.difference),
        reason=found.reason,
        contradictions=found.contradictions,
        versions=found.versions,
        external=list(found.external),
        unknown=found.unknown,
    )


def compared(
    paths: tuple[Path, Path], missing: tuple[str, str], found: LogComparison, tolerance: float, besides: list[str]
) -> Compared:
    """The document of a comparison."""
    signals = sorted(found.signals.items(), key=lambda item: -item[1].value)
    return Compared(
        a=str(paths[0]),
        b=str(paths[1]),
        same=found.first is None,
        from_s=found.begin_ns / 1e9,
        tolerance=tolerance,
        within=found.within(tolerance),
        missing_a=missing[0],
        missing_b=missing[1],
        messages_same=found.same,
        messages_differing=found.paired,
        first=None if found.first is None else _difference(found.first),
        signals=[SignalRow(name, d.unit, d.value, d.at_ns / 1e9, d.differing) for name, d in signals],
        others=dict(found.others),
        only_a=dict(found.only_a),
        only_b=dict(found.only_b),
        besides=besides,
    )


def contents(found: Info) -> LogContents:
    """The document of a log's content."""
    values = asdict(found)
    values["faults"] = [
        {"id": fault.id, "from_s": fault.begin, "to_s": fault.end, "what": fault.what} for fault in found.faults
    ]
    values["events"] = [event._asdict() for event in found.events]
    return convert(values, LogContents)


def _difference(found: Difference) -> FirstDifference:
    a, b = found.left, found.right
    fields = []
    if a.record is not None and b.record is not None and a.record[:4] == b.record[:4]:
        for one, other in zip_longest(a.values, b.values):
            if not same(one, other):
                path, _, unit = one or other
                fields.append(FieldRow(path, unit, _plain(one), _plain(other)))
    return FirstDifference(found.number, _message(a), _message(b), fields)


def _message(side: Side) -> MessageRow | None:
    record = side.record
    if record is None:
        return None
    return MessageRow(record.topic, record.log_ns / 1e9, record.publish_ns / 1e9, record.sequence)


def _plain(value: FieldValue | None) -> Plain:
    if value is None:
        return None
    found: Plain = value.value.hex() if isinstance(value.value, bytes) else value.value
    return found
