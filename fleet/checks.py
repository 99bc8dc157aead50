"""Verdicts: the checks that a scenario declares, judged on what the run recorded."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from fleet.fields import vehicle_numbers
from fleet.journal import Journal
from fleet.schema import AtMost, Below, ChecksSection


@dataclass(frozen=True, slots=True)
class Verdict:
    """One check: what was asked, what was found."""

    check: str
    passed: bool
    asked: str
    found: str

    def to_values(self) -> dict[str, Any]:
        return asdict(self)


def judge(checks: ChecksSection, journal: Journal, middleware_lost: int) -> list[Verdict]:
    """Judge every declared check, in the order of the schema."""
    verdicts = []
    for name in ("formation_error", "consensus_error"):
        below: Below | None = getattr(checks, name)
        if below is not None:
            verdicts.append(_below(name, below, journal))
    if checks.qp_infeasible is not None:
        failures = sum(series.qp_failures for series in journal.metrics.series.values())
        verdicts.append(_at_most("qp_infeasible", checks.qp_infeasible, failures))
    if checks.ledger is not None:
        unbalanced = journal.ledger.unbalanced()
        found = "balanced" if not unbalanced else ", ".join(f"{s}->{d} off by {n}" for (s, d), n in unbalanced.items())
        verdicts.append(Verdict("ledger", not unbalanced, "balanced", found))
    if checks.middleware_loss is not None:
        verdicts.append(_at_most("middleware_loss", checks.middleware_loss, middleware_lost))
    return verdicts


def _below(name: str, check: Below, journal: Journal) -> Verdict:
    after_s = check.after / 1e9
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    value, vehicle, at_s = journal.metrics.worst("formation" if name == "formation_error" else "e", after_s, who)
    asked = f"below {check.below:g} m after {after_s:g} s" + (f", vehicles {check.vehicles}" if who else "")
    if vehicle == 0:
        return Verdict(name, False, asked, f"the run ended at {at_s:g} s, before the check begins")
    return Verdict(name, value < check.below, asked, f"at most {value:.4g} m (vehicle {vehicle}, {at_s:g} s)")


def _at_most(name: str, check: AtMost, found: int) -> Verdict:
    return Verdict(name, found <= check.at_most, f"at most {check.at_most}", str(found))
