"""A study in one row per point: how many runs passed, and the medians of some measures, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from fleet.study.measures import MeasureColumn, find_columns
from fleet.study.row import PREFIX, Reached
from fleet.study.statistics import Estimate, median, pass_rate
from fleet.study.store import Store

# The checks that judge a number which changes with what is varied, and the units of the number and its margin.
_JUDGED = {
    "formation_error": ("m", "m"), "consensus_error": ("m", "m"), "recovery_time": ("s", "m"),
    "min_separation": ("m", "m"), "max_age": ("s", "s"),
}  # fmt: skip
DEFAULT = ("formation_final_m", "age_p95_s", "loss_share")


@dataclass(frozen=True, slots=True)
class PointSummary:
    values: dict[str, float | str]  # by key of the axis
    runs: int  # that were made
    failed: int  # of those, without a result
    passed: Estimate
    medians: dict[str, Estimate]  # by measure


def judged_columns(checks: Sequence[str]) -> list[MeasureColumn]:
    """What the first of these checks judged, and by how much it passed; nothing if none of them judges a number."""
    name = next((name for name in checks if name in _JUDGED), None)
    if name is None:
        return []
    of_value, of_margin = _JUDGED[name]
    return [
        MeasureColumn(f"value.{name}", of_value, missing_is_largest=name != "min_separation"),
        MeasureColumn(f"margin.{name}", of_margin),
    ]


def summarise(store: Store, measures: Sequence[MeasureColumn] = ()) -> list[PointSummary]:
    """The summary of each point that has a run, in the order of the points. `measures`: the measures to summarise.
    Empty: the measures of the study, or else `DEFAULT`. Raises StudyError: the study is damaged."""
    chosen = list(measures) or find_columns(store.record.measures or DEFAULT, store.record.columns)
    found = []
    for number, each in groupby(store.rows([column.name for column in chosen]), lambda row: row.point):
        rows = list(each)
        judged = [row for row in rows if row.has_result]
        passed = pass_rate(sum(row.passed is True for row in judged), len(judged))
        medians = {c.name: median([c.number(row.number(c.name)) for row in judged]) for c in chosen}
        found.append(PointSummary(store.points[number].values, len(rows), len(rows) - len(judged), passed, medians))
    return found


def reached(store: Store) -> list[Reached]:
    """How often the runs of a study reached what some run must reach. Raises StudyError."""
    found = [Reached(c.name.removeprefix(PREFIX)) for c in store.record.columns if c.name.startswith(PREFIX)]
    if found:
        for row in store.rows([PREFIX + one.name for one in found]):
            for one in found:
                one.count(row)
    return found
