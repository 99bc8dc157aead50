"""What became of each packet of a link, as a trace that a scenario can use again: `fleet export --traces`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from pathlib import Path

from fleet.errors import FleetError
from fleet.logs.open_log import Log
from fleet.logs.topic import Topic
from fleet.logs.topic_names import link_topic
from fleet.scenario.sections.trace_table import TraceRow, TraceTable
from fleet.scenario.text.yaml_writer import yaml_text
from netem.cause import Cause
from netem.limits import TRACE
from netem.whole_file import write_whole

LINKS = "links.yaml"
_COLUMNS = ("time", "delivered", "delay")


def write_traces(
    log: Log, folder: Path, *, force: bool = False, say: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Write a trace for each directed link into a folder, made if need be, and how a scenario uses them all; returns
    the files, `links.yaml` last. `say` hears what a trace does not hold. Raises FleetError if a file is in the way and
    not to be replaced (`force`), the place cannot be written, or a link has too many packets; LogReadError if the log
    is damaged.
    """
    if not log.links:
        raise FleetError(f"{log.path} has no packets: its network is ideal, or nobody hears anybody")
    try:
        tick_ns = int(log.run["tick_ns"])
    except (KeyError, ValueError):
        raise FleetError(f"{log.path} does not say how long a tick is, so it is no log of a run") from None
    texts, links = {}, {}
    for src, dst in log.links:
        topic = log[link_topic((src, dst))]
        name = f"{src}-{dst}.csv"
        table = link_trace(topic, tick_ns, say)
        if len(table.rows) > TRACE.items:
            raise FleetError(f"{topic.name} has {len(table.rows)} packets; a trace holds {TRACE.items} at most")
        if table.rows:
            texts[name] = table.text()
            links[f"{src}->{dst}"] = {"trace": name, "by": "packet"}
    texts[LINKS] = yaml_text({"links": links})
    return write_files(folder, texts, force=force)


def write_files(folder: Path, texts: Mapping[str, str], *, force: bool) -> list[Path]:
    """Write texts into a folder, made if need be, and return the files. Raises FleetError if a file is in the way and
    not to be replaced (`force`), or the place cannot be written.
    """
    if (there := [name for name in texts if (folder / name).exists()]) and not force:
        raise FleetError(f"{folder} already holds {there[0]}; choose another place, or replace it with --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            write_whole(folder / name, text.encode(), 0o644)
    except OSError as error:
        raise FleetError(f"cannot write to {folder}: {error.strerror}") from error
    return [folder / name for name in texts]


def link_trace(topic: Topic, tick_ns: int, say: Callable[[str], None] = lambda _: None) -> TraceTable:
    """A row per packet of a link: the first undamaged copy that arrived, or that none did.

    A damaged packet counts as lost, since its receiver refuses it. A packet under way at the end of the run also counts
    as lost, unless its delay takes it beyond the end.
    """
    rows: dict[int, tuple[tuple[float, int], TraceRow]] = {}  # by number: when its copy was usable, and its delay
    fields = (topic[name].tolist() for name in ("seq", "sent", "due", "delay", "fate", "corrupted"))
    for at, seq, sent, due, delay, fate, corrupted in zip(topic.t.tolist(), *fields, strict=True):
        sent_ns, delay_ns = round(sent * 1e9), round(delay * 1e9)
        arrives = fate == Cause.DELIVERED
        if fate == Cause.IN_FLIGHT:
            arrives = sent_ns + max(1, -(-delay_ns // tick_ns)) * tick_ns >= round(at * 1e9)
        lost = corrupted or not arrives
        usable = (inf, 0) if lost else (due, delay_ns)
        if seq not in rows or usable < rows[seq][0]:
            rows[seq] = usable, TraceRow(sent_ns, not lost, None if lost else delay_ns)
    if rows and (missing := max(rows) + 1 - len(rows)):
        say(f"{topic.name}: {missing} packets are not in the log, so the n-th row is not the n-th packet behind them")
    return TraceTable(_COLUMNS, tuple(rows[seq][1] for seq in sorted(rows)))
