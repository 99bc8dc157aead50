"""What a study measures of each run: numbers by name, from the same values that `result.json` has.

A number that a run does not have is NaN: the time after which vehicles settled that did not, the age of what never
came. So it is no number in a table, and counts as missing in a median.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite, nan
from statistics import median
from typing import Any

from fleet.study.errors import StudyError
from netem.parsing import nearest

Values = Mapping[str, Any]  # of a run, as result.json has them


@dataclass(frozen=True, slots=True)
class Measure:
    """A number of a run.

    Attributes:
        name: with the unit behind it, as in `e_rms_m`.
        unit: as people write it.
        what: in words.
        of: computes it.
    """

    name: str
    unit: str
    what: str
    of: Callable[[Values], float]


def _over_vehicles(key: str, join: Callable[[list[float]], float]) -> Callable[[Values], float]:
    """A number of all vehicles; NaN if one of them does not have it."""

    def compute(values: Values) -> float:
        rows = values["vehicles"].values()
        found = [nan if row[key] is None else float(row[key]) for row in rows]
        return join(found) if found and all(map(isfinite, found)) else nan

    return compute


def _over_links(key: str, join: Callable[[Iterable[float]], float]) -> Callable[[Values], float]:
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


MEASURES: dict[str, Measure] = {
    measure.name: measure
    for measure in (
        Measure("formation_final_m", "m", "final formation error of the worst vehicle", _over_vehicles("formation_final_m", max)),
        Measure("formation_median_m", "m", "final formation error of the median vehicle", _over_vehicles("formation_final_m", median)),
        Measure("e_final_m", "m", "final consensus error of the worst vehicle", _over_vehicles("e_final_m", max)),
        Measure("e_rms_m", "m", "RMS of the consensus error over the last 10 s, of the worst vehicle", _over_vehicles("e_rms_m", max)),
        Measure("settle_5cm_s", "s", "time after which every consensus error stays below 5 cm", _over_vehicles("settle_5cm_s", max)),
        Measure("settle_10pct_s", "s", "time after which every consensus error stays below a tenth of its start", _over_vehicles("settle_10pct_s", max)),
        Measure("effort_Ns", "N s", "integral of the surge force, mean of the vehicles", _over_vehicles("effort_Ns", lambda row: sum(row) / len(row))),
        Measure("u_cmd_max_mps", "m/s", "largest commanded speed of any vehicle", _over_vehicles("u_cmd_max_mps", max)),
        Measure("qp_failures", "", "times that the gain's optimisation failed", _over_vehicles("qp_failures", sum)),
        Measure("payloads_rejected", "", "payloads that agents refused", _over_vehicles("payloads_rejected", sum)),
        Measure("packets_sent", "", "packets sent on all links", _packets("sent")),
        Measure("packets_delivered", "", "packets delivered", _packets("delivered")),
        Measure("packets_lost", "", "packets lost, for any cause", _lost),
        Measure("packets_corrupted", "", "packets damaged on the way", _packets("corrupted")),
        Measure("loss_share", "", "share of the packets that were lost", _loss),
        Measure("age_mean_s", "s", "mean age of what is known of a neighbour, of the worst link", _over_links("mean_s", max)),
        Measure("age_p95_s", "s", "95th percentile of that age, of the worst link", _over_links("p95_s", max)),
        Measure("age_max_s", "s", "largest such age", _over_links("max_s", max)),
        Measure("tumbles", "", "times that a vehicle tumbled", lambda values: float(len(values["tumbles"]))),
        Measure("deaths", "", "agents that ended by themselves", lambda values: float(sum(map(len, values["deaths"].values())))),
        Measure("checks_failed", "", "checks that failed", _failed),
        Measure("sim_s", "s", "simulated time", lambda values: float(values["sim_s"])),
        Measure("wall_s", "s", "wall time of the run", lambda values: float(values["wall"]["run_s"])),
    )
}  # fmt: skip


def chosen(names: Iterable[str]) -> list[Measure]:
    """The measures of these names.

    Raises:
        StudyError: there is none of a name.
    """
    found = []
    for name in names:
        if name not in MEASURES:
            raise StudyError(
                f'there is no measure "{name[:60]}"; {nearest(name, MEASURES) or "fleet sweep --help lists them"}'
            )
        found.append(MEASURES[name])
    return found
