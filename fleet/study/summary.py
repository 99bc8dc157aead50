"""A study in one row per point: how many runs passed, and the medians of some measures, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fleet.study.measures import MEASURES, Measure
from fleet.study.one_run import FAILED
from fleet.study.statistics import Estimate, median, pass_rate
from fleet.study.store import Store

DEFAULT = ("formation_final_m", "age_p95_s", "loss_share")


@dataclass(frozen=True, slots=True)
class PointSummary:
    """What the runs of one point came to."""

    values: dict[str, float | str]  # by key of the axis
    runs: int  # that were made
    failed: int  # of those, without a result
    passed: Estimate
    medians: dict[str, Estimate]  # by measure


def summarise(store: Store, measures: Sequence[Measure] = ()) -> list[PointSummary]:
    """The summary of each point that has a run, in the order of the points. Raises StudyError."""
    keys = [axis.key for axis in store.record.axes]
    chosen = list(measures) or [MEASURES[name] for name in DEFAULT]
    table = store.table(["point", "seed", "status", "passed", *keys, *(measure.name for measure in chosen)])
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
                {measure.name: median([_number(row[measure.name]) for row in judged]) for measure in chosen},
            )
        )
    return found


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
