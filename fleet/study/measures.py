"""What a study measures of each run: numbers by name, from the same values that `result.json` has.

A number that a run does not have is NaN, so it is no number in a table. In a median some of them count as larger than
every number: the time after which vehicles settled that did not, the age of what was never heard, the error of what
diverged. A point whose runs hardly ever settle must not look as fast as those that did. Any other one is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isfinite, nan
from statistics import fmean, median
from typing import Any

import msgspec

Join = Callable[[list[float]], float]
Values = Mapping[str, Any]  # of a run, as result.json has them


class MeasureColumn(msgspec.Struct, frozen=True):
    """A number that every row of a study has.

    Attributes:
        name: with the unit behind it, as in `e_rms_m`; of a signal's measure as it is asked for: `p95 |error.e|`.
        unit: as people write it.
        missing_is_largest: where there is no number, it counts as larger than every number.
    """

    name: str
    unit: str
    missing_is_largest: bool = False

    def number(self, value: float | None) -> float:
        """A value of the column as statistics take it: inf or NaN where it is missing."""
        if value is not None and isfinite(value):
            return value
        return inf if self.missing_is_largest else nan


@dataclass(frozen=True, slots=True)
class Measure:
    """A number of a run that every study has."""

    column: MeasureColumn
    what: str  # in words
    of: Callable[[Values], float]  # computes it

    @property
    def name(self) -> str:
        return self.column.name


def _over_vehicles(key: str, join: Join) -> Callable[[Values], float]:
    """A number of all vehicles; NaN if one of them does not have it."""

    def compute(values: Values) -> float:
        rows = values["vehicles"].values()
        found = [nan if row[key] is None else float(row[key]) for row in rows]
        return join(found) if found and all(map(isfinite, found)) else nan

    return compute


def _over_links(key: str, join: Join) -> Callable[[Values], float]:
    """The ages of all links; NaN if one of them heard nothing."""

    def compute(values: Values) -> float:
        found = [row[key] for link, row in values["ages"].items() if link != "*"]
        return join(found) if found and all(x is not None and isfinite(x) for x in found) else nan

    return compute


def _packets(key: str) -> Callable[[Values], float]:
    return lambda values: float(sum(account[key] for account in values["ledger"].values()))


def _lost(values: Values) -> float:
    return float(sum(sum(account["lost"].values()) for account in values["ledger"].values()))


def _loss(values: Values) -> float:
    sent = _packets("sent")(values)
    return _lost(values) / sent if sent else nan


def _failed(values: Values) -> float:
    return float(sum(not check["passed"] for check in values["checks"])) if values["checks"] else nan


_VEHICLES: tuple[tuple[str, str, str, str, Join], ...] = (  # name, key of result.json, unit, what, joined over vehicles
    ("formation_final_m", "formation_final_m", "m", "final formation error of the worst vehicle", max),
    ("formation_median_m", "formation_final_m", "m", "final formation error of the median vehicle", median),
    ("e_final_m", "e_final_m", "m", "final consensus error of the worst vehicle", max),
    ("e_rms_m", "e_rms_m", "m", "RMS of the consensus error over the last 10 s, worst vehicle", max),
    ("settle_5cm_s", "settle_5cm_s", "s", "time from which every consensus error stays below 5 cm", max),
    ("settle_10pct_s", "settle_10pct_s", "s", "time from which it stays below a tenth of its start", max),
    ("effort_Ns", "effort_Ns", "N s", "integral of the surge force, mean of the vehicles", fmean),
    ("u_cmd_max_mps", "u_cmd_max_mps", "m/s", "largest commanded speed of any vehicle", max),
    ("qp_failures", "qp_failures", "", "times that the gain's optimisation failed", sum),
    ("payloads_rejected", "payloads_rejected", "", "payloads that agents refused", sum),
)
_LINKS: tuple[tuple[str, str, str, str], ...] = (  # name, key of result.json, unit, what; of the worst link
    ("age_mean_s", "mean_s", "s", "mean age of what is known of a neighbour, worst link"),
    ("age_p95_s", "p95_s", "s", "95th percentile of the age of what is known of a neighbour, worst link"),
    ("age_max_s", "max_s", "s", "largest age of what is known of a neighbour"),
)
_RUN: tuple[tuple[str, str, str, Callable[[Values], float]], ...] = (
    ("packets_sent", "", "packets sent on all links", _packets("sent")),
    ("packets_delivered", "", "packets delivered", _packets("delivered")),
    ("packets_lost", "", "packets lost, for any cause", _lost),
    ("packets_corrupted", "", "packets damaged on the way", _packets("corrupted")),
    ("loss_share", "", "share of the packets that were lost", _loss),
    ("tumbles", "", "times that a vehicle tumbled", lambda values: float(len(values["tumbles"]))),
    ("deaths", "", "agents that ended by themselves", lambda values: float(sum(map(len, values["deaths"].values())))),
    ("checks_failed", "", "checks that failed", _failed),
    ("sim_s", "s", "simulated time", lambda values: float(values["sim_s"])),
    ("wall_s", "s", "wall time of the run", lambda values: float(values["wall"]["run_s"])),
)
_LARGEST = frozenset(  # where they are missing; else nothing is known
    {
        *("formation_final_m", "formation_median_m", "e_final_m", "e_rms_m", "settle_5cm_s", "settle_10pct_s"),
        *(name for name, *_ in _LINKS),
    }
)
MEASURES: dict[str, Measure] = {
    name: Measure(MeasureColumn(name, unit, name in _LARGEST), what, of)
    for name, unit, what, of in (
        *((name, unit, what, _over_vehicles(key, join)) for name, key, unit, what, join in _VEHICLES),
        *((name, unit, what, _over_links(key, max)) for name, key, unit, what in _LINKS),
        *_RUN,
    )
}
SEPARATION = MeasureColumn("separation_min_m", "m")  # least distance of two vehicles
MORE_IS_BETTER = frozenset({"packets_delivered", "sim_s", SEPARATION.name})  # of all others less is
STANDING = (*(measure.column for measure in MEASURES.values()), SEPARATION)  # of every study
