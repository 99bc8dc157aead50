"""`fleet export --traces` of a recording: what became of each message of a key, as a trace that links can follow.

A recording has only the messages that arrived. If the sender counts its messages, a gap in their numbers shows a loss.
The numbers are in the attachments of rmw_zenoh, in a field of JSON payloads, or in the `sequence` of an MCAP file.
`fleet record` counts arrivals in `sequence`, so its own files need one of the others. If the sender does not count, a
known period between two messages shows the gaps. The delay is the time of arrival minus the time of sending. It is
right if both clocks are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from fleet.addons.robots.ros2 import rmw
from fleet.errors import FleetError
from fleet.logs.export import file_names
from fleet.logs.link_traces import write_files
from fleet.mcap.reader import LogReader, OnProgress, log_path
from fleet.mcap.traffic import ATTACHMENT, DELETE, KIND
from fleet.replay.capture import PROFILE
from fleet.scenario.sections.trace_table import TraceRow, TraceTable
from netem.limits import TRACE

_RESTARTED = 100  # a number so far below the highest is that of a sender that began anew, and no late message


class RecordedMessage(NamedTuple):
    """A message as a recording has it."""

    number: int | None  # the sender's; None: it tells none
    sent_ns: int
    at_ns: int


class FieldSelection(NamedTuple):
    """The messages that become traces, and where their numbers are."""

    keys: Sequence[str] = ()  # patterns; empty: all
    exclude: Sequence[str] = ()
    sequence: str | None = None  # field of JSON payloads, `header.seq`; None: payloads are not read
    period_ns: int | None = None  # between two messages of a key without numbers; goes before those of an MCAP file

    def has(self, key: str) -> bool:
        """Whether the messages of a key are wanted."""
        wanted = not self.keys or any(fnmatchcase(key, pattern) for pattern in self.keys)
        return wanted and not any(fnmatchcase(key, pattern) for pattern in self.exclude)


def write_field_traces(
    log: Path,
    folder: Path,
    selection: FieldSelection,
    *,
    force: bool = False,
    say: Callable[[str], None],
    on_progress: OnProgress,
) -> list[Path]:
    """Write a trace for each key of a recording, and for each publisher if they count on their own.

    Args:
        log: the recording.
        folder: where the traces go, made if need be.
        selection: which keys, and where the numbers of messages are.
        force: replace files that are there.
        say: hears one line per trace, and what a trace does not hold.
        on_progress: progress.

    Returns:
        The files.

    Raises:
        FleetError: no key tells what was lost, a file is in the way, or the place cannot be written.
        LogReadError: the file is no log.
    """
    found = _arrivals(log_path(log), selection, say, on_progress)
    if not found:
        raise FleetError(f"{log} has no message on such a key; fleet info lists the keys")
    zero_ns = min(arrival.sent_ns for arrivals in found.values() for arrival in arrivals)
    texts, files = {}, file_names(found)
    for name, arrivals in found.items():
        numbers = _numbers(arrivals, selection.period_ns)
        if numbers is None:
            without = sum(arrival.number is None for arrival in arrivals)
            what = f"{without} of {len(arrivals)} messages have no number" if without else "all have the same number"
            say(f"{name}: left out, because {what}: give --sequence FIELD or --period TIME")
            continue
        table = trace_of(arrivals, numbers, zero_ns)
        for line in (summary(table), *_doubts(arrivals, numbers)):
            say(f"{name}: {line}")
        texts[f"{files[name]}.csv"] = table.text()
    if not texts:
        raise FleetError(f"{log} does not tell what was lost: give --sequence FIELD or --period TIME")
    return write_files(folder, texts, force=force)


def trace_of(arrivals: Sequence[RecordedMessage], numbers: Sequence[int], zero_ns: int) -> TraceTable:
    """A row per message from the first that arrived to the last: the first copy, or that none arrived.

    Args:
        arrivals: in the order of arrival.
        numbers: of each, without restarts.
        zero_ns: time 0 of the trace.

    Returns:
        The trace, of TRACE.items messages at most. Times of lost messages are interpolated. Without times of sending
        there is no delay, and times are those of arrival.
    """
    first_copies: dict[int, RecordedMessage] = {}
    for number, arrival in zip(numbers, arrivals, strict=True):
        first_copies.setdefault(number, arrival)
    columns = ("time", "delivered", *(("delay",) if _has_send_times(arrivals) else ()))
    rows: list[TraceRow] = []
    last = before_ns = 0  # of the message before
    for number, arrival in sorted(first_copies.items()):
        time_ns = arrival.sent_ns - zero_ns
        if rows:
            time_ns = max(time_ns, before_ns)  # a clock that was set back
            step = (time_ns - before_ns) / (number - last)
            missing = min(number - last, TRACE.items + 1 - len(rows))
            rows += [TraceRow(before_ns + round(step * k), delivered=False) for k in range(1, missing)]
        delay_ns = max(0, arrival.at_ns - arrival.sent_ns) if len(columns) > 2 else None
        rows.append(TraceRow(time_ns, delivered=True, delay_ns=delay_ns))
        last, before_ns = number, time_ns
        if len(rows) >= TRACE.items:
            break
    return TraceTable(columns, tuple(rows[: TRACE.items]))


def summary(table: TraceTable) -> str:
    """Loss, the longest gap and the delay of a trace, in words."""
    rows = table.rows
    seconds = ((rows[-1].time_ns or 0) - (rows[0].time_ns or 0)) / 1e9
    gap = longest = 0
    for row in rows:
        gap = 0 if row.delivered else gap + 1
        longest = max(longest, gap)
    lost = 100 * sum(not row.delivered for row in rows) / len(rows)
    text = f"{len(rows)} messages in {seconds:.4g} s, {lost:.3g} % lost, up to {longest} in a row"
    delays = [row.delay_ns for row in rows if row.delay_ns is not None]
    if not delays:
        return f"{text}; no time of sending, so no delay"
    median, late = (float(q) / 1e6 for q in np.quantile(delays, (0.5, 0.95), method="inverted_cdf"))
    return f"{text}; delay {median:.4g} ms (median), {late:.4g} ms (95 %)"


def _has_send_times(arrivals: Sequence[RecordedMessage]) -> bool:
    """Whether there are times of sending: without them both times are equal."""
    return any(arrival.sent_ns != arrival.at_ns for arrival in arrivals)


def _doubts(arrivals: Sequence[RecordedMessage], numbers: Sequence[int]) -> Iterator[str]:
    early = [arrival.sent_ns - arrival.at_ns for arrival in arrivals if arrival.sent_ns > arrival.at_ns]
    if early:
        yield (
            f"{len(early)} messages arrived before they were sent, by up to {max(early) / 1e6:.3g} ms: the clocks "
            "disagree, so delays are wrong by at least as much; these count as 0"
        )
    if (total := max(numbers) - min(numbers) + 1) > TRACE.items:
        yield f"only the first {TRACE.items} of {total} messages, which is as many as a trace holds"


def _numbers(arrivals: list[RecordedMessage], period_ns: int | None) -> list[int] | None:
    """The numbers of messages, without restarts; None: nothing tells them. Sorts by time if the period tells them."""
    told = [arrival.number for arrival in arrivals]
    found: list[int] = []
    if len(set(told)) > 1 and None not in told:
        shift, highest = 0, told[0] or 0
        for number in told:
            assert number is not None
            if number + shift < highest - _RESTARTED:
                shift = highest + 1 - number
            found.append(number + shift)
            highest = max(highest, found[-1])
        return found
    if period_ns is None:
        return None
    arrivals.sort(key=lambda arrival: arrival.sent_ns)
    found = [0]
    for before, arrival in pairwise(arrivals):
        found.append(found[-1] + max(1, round((arrival.sent_ns - before.sent_ns) / period_ns)))
    return found


def _arrivals(
    path: Path, selection: FieldSelection, say: Callable[[str], None], on_progress: OnProgress
) -> dict[str, list[RecordedMessage]]:
    """The messages of each key in the order of arrival; of each publisher, if several have numbers on one key."""
    reader = LogReader(path, on_progress)
    found: dict[tuple[str, bytes], list[RecordedMessage]] = {}
    beside: dict[str, tuple[int, bytes]] = {}  # the last attachment of each key, with the number of its message
    for block in reader.blocks():
        for channel, sequence, log_ns, publish_ns, data in block.messages():
            topic, kind = reader.channels[channel].topic, reader.channels[channel].metadata.get(KIND)
            if not selection.has(topic) or kind == DELETE:
                continue
            if kind == ATTACHMENT:
                beside[topic] = sequence, data
                continue
            counted = reader.profile != PROFILE and selection.period_ns is None
            number, sent_ns, publisher = sequence if counted else None, publish_ns, b""
            if topic in beside and beside[topic][0] == sequence:
                with suppress(ValueError):  # an attachment of another kind
                    number, sent_ns, publisher = rmw.unpack(beside[topic][1])
            if selection.sequence is not None:
                number = _field(data, selection.sequence)
            found.setdefault((topic, publisher), []).append(RecordedMessage(number, sent_ns, log_ns))
    if reader.missing:
        say(f"{path}: {reader.missing}")
    if reader.profile != PROFILE and selection.sequence is None and selection.period_ns is None:
        say(f"{path}: its own sequence numbers are used: if its recorder counts arrivals there, no loss shows")
    topics = [topic for topic, _ in found]
    return {
        topic if topics.count(topic) == 1 else f"{topic} {publisher.hex()[:8]}": sorted(arrivals, key=lambda a: a.at_ns)
        for (topic, publisher), arrivals in found.items()
    }


def _field(payload: bytes, path: str) -> int | None:
    """The whole number in a field of a JSON payload; None: there is none."""
    try:
        value = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value if isinstance(value, int) and not isinstance(value, bool) else None
