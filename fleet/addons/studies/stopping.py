"""When a point of a study has enough seeds: as soon as the interval of what is asked for is narrow enough.

Seeds are added in rounds, to each point half as many as it has, and are looked at when all of a round are there. The
decision depends only on the rows of one point: not on workers, nor on the time of a run. So a study that was
interrupted goes on as it would have, and the seeds of all points are a prefix of one sequence, which can be compared in
pairs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import count, islice
from typing import NamedTuple

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import CHECK, STANDING, MeasureColumn, is_of_check
from fleet.addons.studies.row import Row
from fleet.addons.studies.signal_measures import LONGEST_TEXT, find_columns, is_signal, parse_signal
from fleet.addons.studies.statistics import Estimate, median, pass_rate
from netem.parsing import NUMBER

_RULE = re.compile(rf"(?P<what>\S.*?)\s*(?:±|\+/?-)\s*(?P<number>{NUMBER.pattern})\s*(?P<unit>\S.*?)?", re.ASCII)
_PASS = ("pass", "passed")


def estimate(rows: Iterable[Row], column: MeasureColumn | None = None) -> Estimate:
    """Estimate a column from some runs. Without a column, or with that of a check, it is the share that passed. Any
    other column gives its median.
    """
    if column is None:
        passed = [row.passed for row in rows if row.passed is not None]
        return pass_rate(sum(passed), len(passed))
    numbers = [column.number(row.number(column.name)) for row in rows if row.has_result]
    if column.name.startswith(CHECK):
        judged = [number for number in numbers if number == number]
        return pass_rate(round(sum(judged)), len(judged))
    return median(numbers)


class Rule(NamedTuple):
    """When a point has enough: half the width of the 95 % interval is at most `margin`."""

    text: str  # the rule as the user wrote it
    column: MeasureColumn | None  # the rule is on the median of this measure. None: on the share of runs that passed
    margin: float  # in the unit of the column. A share or a relative margin has no unit
    relative: bool  # whether the margin is relative to the median

    @property
    def columns(self) -> list[str]:
        """The columns that it looks at in addition to the verdicts."""
        return [] if self.column is None else [self.column.name]

    def estimate(self, rows: Iterable[Row]) -> Estimate:
        return estimate(rows, self.column)

    def met(self, found: Estimate) -> bool:
        margin = self.margin * abs(found.value) if self.relative else self.margin
        return found.low == found.high or found.half <= margin


def watched_measures(text: str) -> list[str]:
    """The name of the measure that a rule looks at; none: whether runs passed. Raises StudyError."""
    what = _parts(text)["what"]
    return [] if what in _PASS else [what]


def parse_until(text: str, columns: Sequence[MeasureColumn]) -> Rule:
    """`pass ±5 %`, `check.max_age ±5 %`, `e_rms_m ±0.05 m`, `e_rms_m ±10 %`; `+-` is the same as `±`. `columns`:
    measures that there are. Raises StudyError: it is none of them."""
    found = _parts(text)
    unit, margin = found["unit"] or "", float(found["number"])
    column = next(iter(find_columns(watched_measures(text), columns)), None)
    share = column is None or column.name.startswith(CHECK)
    units = ("%", "") if column is None or share else ("%", "", column.unit)
    if unit not in units:
        raise StudyError(f'"{text[:60]}": expected a margin in {" or ".join(filter(None, units))}, got "{unit[:20]}"')
    if unit == "%":
        margin /= 100.0
    if not 0.0 < margin < (0.5 if share else float("inf")):
        least = "above 0 and below 50 %" if share else "above 0"
        raise StudyError(f'"{text[:60]}": expected a margin {least}')
    return Rule(text.strip(), column, margin, not share and unit == "%")


def check_until(text: str) -> None:
    """Raises StudyError: no study can have this rule."""
    unit = _parts(text)["unit"] or ""
    own = [MeasureColumn(str(parse_signal(name)), unit) for name in watched_measures(text) if is_signal(name)]
    own += [MeasureColumn(name, unit) for name in watched_measures(text) if is_of_check(name)]
    parse_until(text, [*STANDING, *own])


def _parts(text: str) -> re.Match[str]:
    found = _RULE.fullmatch(text.strip()) if len(text) <= LONGEST_TEXT else None
    if found is None:
        expected = 'expected "pass ±5 %", "e_rms_m ±0.05 m", "e_rms_m ±10 %" or the like'
        raise StudyError(f'{expected}, got "{text[:60]}"')
    return found


def seed_sequence(first: Sequence[int], most: int) -> list[int]:
    """The seeds that points may have: those of the plan, then the numbers behind the largest of them. `most`: how many;
    not fewer than the plan has."""
    return [*first, *islice(count(max(first) + 1), max(0, most - len(first)))]


def seeds_needed(rule: Rule, rows: Mapping[int, Row], seeds: Sequence[int], first: int) -> int:
    """How many of the seeds a point needs, as far as its rows show. `first`: how many it needs in any case."""
    needed = first
    while needed < len(seeds):
        there = [rows[seed] for seed in seeds[:needed] if seed in rows]
        if len(there) < needed:
            break
        found = rule.estimate(there)
        if rule.met(found) or found.runs == 0:  # more of nothing is nothing
            break
        needed = min(len(seeds), needed + max(1, needed // 2))
    return needed
