"""Link conditions that change by themselves: states with shares of time, and rows of a trace on the run's clock."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

from fleet.scenario.schema.network import LinkSection, LinkStateSection
from fleet.scenario.sections.trace_table import TraceRow, TraceTable
from netem.condition import Condition
from netem.link_selector import parse_selector
from netem.link_states import LinkStates, stationary
from netem.link_trace import LinkTrace


def changing(selector: str, section: LinkSection, traces: Callable[[str], TraceTable]) -> LinkStates | LinkTrace | None:
    """The conditions of a selector's links if they change by themselves; the section must be valid.

    Raises DataFileError: the trace cannot be read.
    """
    if section.states:
        return _states(selector, section.states, together=bool(section.together))
    return None if section.trace is None else link_trace(section, traces(section.trace))


def _states(selector: str, states: dict[str, LinkStateSection], *, together: bool) -> LinkStates:
    named = list(states)
    following = tuple(chances(states, name) for name in named)
    mean = tuple(state.mean for state in states.values())
    return LinkStates(
        tuple(named),
        tuple(state.condition for state in states.values()),
        mean,
        following,
        stationary(mean, following),
        _key(selector) if together else None,
    )


def chances(states: dict[str, LinkStateSection], name: str) -> tuple[float, ...]:
    """The probabilities of the states after a state. If the scenario gives none, all others are equally likely."""
    given = states[name].next
    if given is None:
        return (
            tuple(1.0 / (len(states) - 1) if other != name else 0.0 for other in states) if len(states) > 1 else (0.0,)
        )
    total = sum(given.values())  # 1 but for rounding
    return tuple(given.get(other, 0.0) / total for other in states)


def _key(selector: str) -> tuple[int, int, int]:
    """Numbers that tell selectors apart, for draws; `1<->2` and `2<->1` are the same."""
    s = parse_selector(selector)
    src, dst = s.src or 0, s.dst or 0
    return (min(src, dst), max(src, dst), 1) if s.both else (src, dst, 0)


def first_row(section: LinkSection, table: TraceTable) -> int:
    """The number of the first row of a trace.

    By time it is the row in force, by packet the first that is not earlier.
    """
    if section.start is None:
        return 0
    times = [row.time_ns or 0 for row in table.rows]
    at = bisect_left(times, section.start)
    in_force = at == len(times) or times[at] > section.start
    return max(0, at - 1) if in_force and section.by != "packet" else at


def link_trace(section: LinkSection, table: TraceTable) -> LinkTrace:
    """The rows of a trace as a link uses them; the section must be valid for this table."""
    known: dict[TraceRow, Condition] = {}  # many packets have one fate: their condition is kept once
    rows = table.rows[first_row(section, table) :]
    conditions = []
    for row in rows:
        bare = TraceRow(None, row.delivered, row.delay_ns, row.rate_bit_s, row.snr_db)
        conditions.append(known.setdefault(bare, row.condition(section.lost_below)))
    loop, offset = bool(section.loop), section.offset is not None
    if section.by == "packet":
        return LinkTrace(tuple(conditions), loop=loop, offset=offset)
    begin = section.start if section.start is not None else rows[0].time_ns or 0
    scale = section.time_scale or 1.0
    times = [max(0, round(((row.time_ns or 0) - begin) * scale)) for row in rows]
    return LinkTrace(tuple(conditions), tuple(times), times[-1] + max(1, _last_ns(times)), loop, offset)


def _last_ns(times: list[int]) -> int:
    """How long the last row is in force: as long as the last one before it that was in force at all."""
    steps = (after - before for before, after in zip(times[-2::-1], times[:0:-1], strict=True))
    return next((step for step in steps if step), 10**9)
