"""A study in one row per point: how many runs passed, and the medians of some measures, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fleet.study.measures import MeasureColumn
from fleet.study.one_run import FAILED
from fleet.study.signal_measures import find_columns
from fleet.study.sometimes import PREFIX, Reached, column_of
from fleet.study.statistics import Estimate, median, pass_rate
from fleet.study.store import Store

DEFAULT = ("formation_final_m", "age_p95_s", "loss_share")


@dataclass(frozen=True, slots=True)
class PointSummary:
    """The results of one point's runs."""

    values: dict[str, float | str]  # by key of the axis
    runs: int  # that were made
    failed: int  # of those, without a result
    passed: Estimate
    medians: dict[str, Estimate]  # by measure


def summarise(store: Store, measures: Sequence[MeasureColumn] = ()) -> list[PointSummary]:
    """The summary of each point that has a run, in the order of the points.

    Args:
        store: the study.
        measures: the measures to summarise. Empty: the measures of the study, or else `DEFAULT`.

    Raises:
        StudyError: the study is damaged.
    """
    keys = [axis.key for axis in store.record.axes]
    chosen = list(measures) or find_columns(store.record.measures or DEFAULT, store.record.columns)
    table = store.table(["point", "seed", "status", "passed", *keys, *(column.name for column in chosen)])
    by_point: dict[int, list[dict[str, Any]]] = {}
    for row in table.to_pylist():
        by_point.setdefault(row["point"], []).append(row)
    found = []
    for rows in by_point.values():
        judged = [row for row in rows if row["status"] != FAILED]
        found.append(
            PointSummary(
                {key: rows[0][key] for key in keys},
                len(rows),
                len(rows) - len(judged),
                pass_rate(sum(row["passed"] is True for row in judged), len(judged)),
                {column.name: median([column.number(row[column.name]) for row in judged]) for column in chosen},
            )
        )
    return found


def reached(store: Store) -> list[Reached]:
    """How often the runs of a study reached what some run must reach. Raises StudyError."""
    found = [Reached(c.name.removeprefix(PREFIX)) for c in store.record.columns if c.name.startswith(PREFIX)]
    if found:
        for row in store.table(["seed", *(column_of(one.name) for one in found)]).to_pylist():
            for one in found:
                one.count(row)
    return found
