"""A study in one row per point: how many runs passed, and the medians of some measures, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from fleet.addons.studies.measures import JUDGED, MeasureColumn, columns_of_checks
from fleet.addons.studies.row import LATE, PREFIX, Reached
from fleet.addons.studies.signal_measures import find_columns
from fleet.addons.studies.statistics import Estimate
from fleet.addons.studies.stopping import estimate
from fleet.addons.studies.store import Store

DEFAULT = ("formation_final_m", "age_p95_s", "loss_share")
WITHOUT_PLACES = DEFAULT[1:]  # of robots of others nobody measures where they are, and moored vehicles stay


@dataclass(frozen=True, slots=True)
class PointSummary:
    values: dict[str, float | str]  # by key of the axis
    runs: int  # that were made
    failed: int  # of those, without a result
    late: int  # of programs on the wall clock: whose host was late, so that they are no results
    passed: Estimate
    medians: dict[str, Estimate]  # by measure; of `check.NAME` the share of runs that passed it


def judged_columns(checks: Sequence[str]) -> list[MeasureColumn]:
    """What the first of these checks judged, and by how much it passed; nothing if none of them judges a number."""
    first = [name for name in checks if name in JUDGED][:1]
    return columns_of_checks(first)[1:]


def summarise(store: Store, measures: Sequence[MeasureColumn] = ()) -> list[PointSummary]:
    """The summary of each point that has a run, in the order of the points. `measures`: the measures to summarise.
    Empty: the measures of the study, or else `DEFAULT`. Raises StudyError: the study is damaged."""
    chosen = list(measures) or find_columns(store.record.measures or DEFAULT, store.record.every_column)
    found = []
    for number, each in groupby(store.rows([column.name for column in chosen]), lambda row: row.point):
        rows = list(each)
        lates = sum(row.status == LATE for row in rows)
        failed = sum(not row.has_result for row in rows) - lates
        medians = {column.name: estimate(rows, column) for column in chosen}
        found.append(PointSummary(store.points[number].values, len(rows), failed, lates, estimate(rows), medians))
    return found


def sometimes_reached(store: Store) -> list[Reached]:
    """How often the runs of a study reached what some run must reach. Raises StudyError."""
    found = [Reached(c.name.removeprefix(PREFIX)) for c in store.record.columns if c.name.startswith(PREFIX)]
    if found:
        for row in store.rows([PREFIX + one.name for one in found]):
            for one in found:
                one.count(row)
    return found
