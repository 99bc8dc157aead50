"""Rules on links whose condition changes by itself: states and traces."""

from __future__ import annotations

from collections.abc import Iterator

from fleet.quantities import show_time
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report
from fleet.scenario.schema.network import LinkSection, LinkStateSection
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.graph import reachable
from fleet.scenario.sections.trace_table import TraceTable
from netem.parsing import nearest

MOST_STATES = 16
# Characters of all traces together, because a merged scenario has 1,000,000 at most. They hold about 20 links for 10
# minutes at 10 Hz. A trace is text there, because a log must run again without the file; compressed bytes would depend
# on the version of zlib.
MOST_CHARACTERS = 900_000
_FORMS = ("condition", "states", "trace")
_OF_TRACES = ("by", "start", "loop", "offset", "time_scale", "lost_below")

Path = tuple[str, ...]


def link_conditions(parts: Parts, report: Report) -> None:
    """Each entry of links is a condition, or states that lead to each other, or a trace that can be used."""
    characters = 0
    for selector, section in parts.spec.network.links.items():
        path = ("network", "links", selector)
        given = [key for key in _FORMS if getattr(section, key) is not None]
        if len(given) != 1:
            got = " and ".join(given) if given else "none of them"
            report.add(path, f"expected one of condition, states and trace, got {got}")
            continue
        if section.together is not None and not section.states:
            report.add((*path, "together"), "has no effect without states", key=True)
        if section.states is not None:
            _states(report, (*path, "states"), section.states, parts.spec.tick)
        if section.trace is not None:
            characters += _trace(parts, report, path, section)
        else:
            for key in _OF_TRACES:
                if getattr(section, key) is not None:
                    report.add((*path, key), "has no effect without a trace", key=True)
    if characters > MOST_CHARACTERS:
        message = f"the traces of all links take {characters} characters, and {MOST_CHARACTERS} is the most"
        report.add(("network", "links"), message, "fewer rows, or states that fleet fit finds in them", key=True)


def _states(report: Report, path: Path, states: dict[str, LinkStateSection], tick: int) -> None:
    if not 2 <= len(states) <= MOST_STATES:
        report.add(path, f"expected 2 to {MOST_STATES} states, got {len(states)}", "one state is a plain condition")
        return
    for name, state in states.items():
        if state.mean < tick:
            message = f"{show_time(state.mean)} is less than a tick, {show_time(tick)}: nobody could see such a state"
            report.add((*path, name, "mean"), message)
        if state.condition.seed is not None:
            message = "a state has no seed of its own: its draws are the link's"
            report.add((*path, name, "condition"), message)
        for problem, hint in _following(states, name):
            report.add((*path, name, "next"), problem, hint)
    after = {
        name: [other for other in states if state.next is None or state.next.get(other, 0.0) > 0.0]
        for name, state in states.items()
    }
    first = next(iter(states))
    for start, end in [*((first, name) for name in states), *((name, first) for name in states)]:
        if end not in reachable([start], after):
            report.add(path, f"{start} never leads to {end}", "every state must lead to every other in the end")
            return


def _following(states: dict[str, LinkStateSection], name: str) -> Iterator[tuple[str, str]]:
    """Mistakes in the next states of a state: a sentence and a hint each."""
    following = states[name].next
    if following is None:
        return
    for other in following:
        if other not in states:
            yield f'there is no state "{other}"', nearest(other, states) or f"there are {', '.join(states)}"
    if name in following:
        yield f"{name} does not follow on itself", "a longer mean keeps the link in it"
    total = sum(following.values())
    if abs(total - 1.0) > 1e-9:
        yield f"expected probabilities that sum up to 100 %, got {100 * total:g} %", ""


def _trace(parts: Parts, report: Report, path: Path, section: LinkSection) -> int:
    """How many characters the trace has in the merged scenario."""
    assert section.trace is not None
    try:
        table = parts.traces(section.trace)
    except DataFileError as error:
        shown = "" if "\n" in section.trace else f"{section.trace}: "
        for problem in error.problems:
            report.add((*path, "trace"), shown + problem)
        return 0
    for key, problem, hint in _misuses(section, table):
        report.add((*path, key), problem, hint, key=key != "trace")
    return len(table.text()) + len(table.rows)  # a line break is two characters there


def _misuses(section: LinkSection, table: TraceTable) -> Iterator[tuple[str, str, str]]:
    """The options that do not fit each other or the columns: key, sentence, and hint."""
    by_packet = section.by == "packet"
    times = [row.time_ns for row in table.rows if row.time_ns is not None]
    has = "it has " + ", ".join(table.columns)
    if not times and not by_packet:
        yield "trace", f"no such column: time, which a trace by time needs; {has}", "by: packet needs none"
    if section.start is not None:
        if not times:
            yield "start", f"no such column: time, in which it would lie; {has}", ""
        elif not times[0] <= section.start <= times[-1]:
            span = f"{show_time(times[0])} to {show_time(times[-1])}"
            yield "start", f"expected a time in the trace, {span}, got {show_time(section.start)}", ""
    if by_packet and section.time_scale is not None:
        yield "time_scale", "has no effect by packet", ""
    if section.offset is not None and not section.loop:
        yield "offset", "needs loop: true, because what lies before the place would never be used", ""
    if "delivered" in table.columns or "snr" not in table.columns:
        if section.lost_below is not None:
            why = "the trace says what was delivered" if "delivered" in table.columns else f"no such column: snr; {has}"
            yield "lost_below", f"has no effect: {why}", ""
    elif section.lost_below is None:
        yield "trace", "it has snr and no delivered", "lost_below: 10 dB says at which ratio a packet is lost"
