"""The measures of a study: numbers by name, from the result of each run.

A number that a run does not have is NaN, so it is no number in a table. In a median some of them count as larger than
every number: the time after which vehicles settled that did not, the age of what was never heard, the error of what
diverged. This way, a point whose runs hardly ever settle does not look as fast as the runs that did. Any other one is
left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf, isfinite, nan
from statistics import fmean, median

import msgspec

from fleet.result.result import LinkAge, Result, VehicleResult
from netem.ledger import Account

Join = Callable[[list[float]], float]


class MeasureColumn(msgspec.Struct, frozen=True):
    """A number that every row of a study has."""

    name: str  # with the unit behind it, as in `e_rms_m`; of a signal the words of the user: `p95 |error.e|`
    unit: str  # as people write it
    missing_is_largest: bool = False  # where there is no number, it counts as larger than every number

    def number(self, value: float | None) -> float:
        """A value of the column as statistics take it: inf or NaN where it is missing."""
        if value is not None and isfinite(value):
            return value
        return inf if self.missing_is_largest else nan


@dataclass(frozen=True, slots=True)
class Measure:
    column: MeasureColumn
    what: str  # in words
    of: Callable[[Result], float]  # computes it


def _join_vehicles(number: Callable[[VehicleResult], float | None], join: Join) -> Callable[[Result], float]:
    """A number of all vehicles; NaN if one of them does not have it."""
    return lambda result: _join([number(row) for row in result.vehicles.values()], join)


def _join_links(number: Callable[[LinkAge], float]) -> Callable[[Result], float]:
    """The largest number of all links; NaN if one of them heard nothing."""
    return lambda result: _join([number(row) for link, row in result.ages.items() if link != "*"], max)


def _join(numbers: list[float | None], join: Join) -> float:
    found = [float(x) for x in numbers if x is not None and isfinite(x)]
    return join(found) if found and len(found) == len(numbers) else nan


def _packets(count: Callable[[Account], int]) -> Callable[[Result], float]:
    return lambda result: float(sum(map(count, result.ledger.values())))


_SENT = _packets(lambda link: link.sent)
_LOST = _packets(lambda link: sum(link.lost.values()))


def _loss(result: Result) -> float:
    sent = _SENT(result)
    return _LOST(result) / sent if sent else nan


def _failed_share(result: Result) -> float:
    return float(sum(not verdict.passed for verdict in result.checks)) if result.checks else nan


# Name, unit, what, the number of one vehicle, joined over vehicles.
_VEHICLES: tuple[tuple[str, str, str, Callable[[VehicleResult], float | None], Join], ...] = (
    ("formation_final_m", "m", "final formation error of the worst vehicle", lambda v: v.formation_final_m, max),
    ("formation_median_m", "m", "final formation error of the median vehicle", lambda v: v.formation_final_m, median),
    ("e_final_m", "m", "final consensus error of the worst vehicle", lambda v: v.e_final_m, max),
    ("e_rms_m", "m", "RMS of the consensus error over the last 10 s, worst vehicle", lambda v: v.e_rms_m, max),
    ("settle_5cm_s", "s", "time from which every consensus error stays below 5 cm", lambda v: v.settle_5cm_s, max),
    ("settle_10pct_s", "s", "time from which it stays below a tenth of its start", lambda v: v.settle_10pct_s, max),
    ("effort_Ns", "N s", "integral of the surge force, mean of the vehicles", lambda v: v.effort_Ns, fmean),
    ("u_cmd_max_mps", "m/s", "largest commanded speed of any vehicle", lambda v: v.u_cmd_max_mps, max),
    ("qp_failures", "", "times that the gain's optimisation failed", lambda v: v.qp_failures, sum),
    ("payloads_rejected", "", "payloads that agents refused", lambda v: v.payloads_rejected, sum),
)
_LINKS: tuple[tuple[str, str, str, Callable[[LinkAge], float]], ...] = (  # name, unit, what, of the worst link
    ("age_mean_s", "s", "mean age of what is known of a neighbour, worst link", lambda age: age.mean_s),
    ("age_p95_s", "s", "95th percentile of the age of what is known of a neighbour, worst link", lambda age: age.p95_s),
    ("age_max_s", "s", "largest age of what is known of a neighbour", lambda age: age.max_s),
)
_RUN: tuple[tuple[str, str, str, Callable[[Result], float]], ...] = (
    ("packets_sent", "", "packets sent on all links", _SENT),
    ("packets_delivered", "", "packets delivered", _packets(lambda link: link.delivered)),
    ("packets_lost", "", "packets lost, for any cause", _LOST),
    ("packets_corrupted", "", "packets damaged on the way", _packets(lambda link: link.corrupted)),
    ("loss_share", "", "share of the packets that were lost", _loss),
    ("tumbles", "", "times that a vehicle tumbled", lambda result: float(len(result.tumbles))),
    ("deaths", "", "agents that ended by themselves", lambda result: float(sum(map(len, result.deaths.values())))),
    ("checks_failed", "", "checks that failed", _failed_share),
    ("sim_s", "s", "simulated time", lambda result: result.sim_s),
    ("wall_s", "s", "wall time of the run", lambda result: result.wall.run_s),
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
        *((name, unit, what, _join_vehicles(number, join)) for name, unit, what, number, join in _VEHICLES),
        *((name, unit, what, _join_links(age)) for name, unit, what, age in _LINKS),
        *_RUN,
    )
}
SEPARATION = MeasureColumn("separation_min_m", "m")  # least distance of two vehicles
MORE_IS_BETTER = frozenset({"packets_delivered", "sim_s", SEPARATION.name})  # of all others less is
STANDING = (*(measure.column for measure in MEASURES.values()), SEPARATION)  # of every study

CHECK = "check."  # of a column whose runs make a share, as those that passed
_OF_CHECK = (CHECK, "value.", "margin.")
# The checks that judge a number which changes with what is varied, and the units of the number and its margin.
JUDGED = {
    "formation_error": ("m", "m"), "consensus_error": ("m", "m"), "recovery_time": ("s", "m"),
    "min_separation": ("m", "m"), "max_age": ("s", "s"),
}  # fmt: skip


def is_of_check(name: str) -> bool:
    return name.startswith(_OF_CHECK)


def columns_of_checks(checks: Iterable[str]) -> list[MeasureColumn]:
    """The three columns that a study has of each of these checks: `check.NAME` is 1 where a run passed it and 0 where
    it did not, `value.NAME` is the number that it judged, and `margin.NAME` its distance from failing.
    """
    found = []
    for name in checks:
        of_value, of_margin = JUDGED.get(name, ("", ""))
        largest = name in JUDGED and name != "min_separation"
        found += [
            MeasureColumn(f"{CHECK}{name}", ""),
            MeasureColumn(f"value.{name}", of_value, missing_is_largest=largest),
            MeasureColumn(f"margin.{name}", of_margin),
        ]
    return found
