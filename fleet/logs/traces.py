"""`fleet export --traces`: what became of each packet of a link, as a trace that a scenario can use again."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from pathlib import Path

from fleet.errors import FleetError
from fleet.logs.open_log import Log
from fleet.logs.topic import Topic
from fleet.logs.topic_names import link_topic
from fleet.scenario.sections.trace_table import MOST_ROWS, TraceRow, TraceTable
from fleet.scenario.text.plain_yaml import yaml_text
from netem.causes import Cause
from netem.whole_file import write_whole

LINKS = "links.yaml"
_COLUMNS = ("time", "delivered", "delay")


def write_traces(
    log: Log, folder: Path, *, force: bool = False, say: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Write a trace for each directed link into a folder, made if need be, and how a scenario uses them all.

    Args:
        force: replace files of the same names.
        say: hears what a trace does not hold.

    Returns:
        the files, `links.yaml` last.

    Raises:
        FleetError: something is in the way, the place cannot be written, or a link has too many packets.
        LogReadError: the log is damaged.
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
        if len(table.rows) > MOST_ROWS:
            raise FleetError(f"{topic.name} has {len(table.rows)} packets; a trace holds {MOST_ROWS} at most")
        if table.rows:
            texts[name] = table.text()
            links[f"{src}->{dst}"] = {"trace": name, "by": "packet"}
    texts[LINKS] = yaml_text({"links": links})
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
