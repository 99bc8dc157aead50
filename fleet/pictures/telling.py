"""Which picture shows best what a run came to: the one at the top of a report."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fleet.pictures.any_signal import file_name
from fleet.pictures.runs import Run
from fleet.scenario.sections.signals import parse_name

_OF_CHECKS = {
    "formation_error": "formation", "consensus_error": "error", "recovery_time": "formation", "tumbled": "formation",
    "min_separation": "track", "deaths": "track", "max_age": "ages", "connected": "links", "ledger": "links",
    "middleware_loss": "links",
}  # fmt: skip
_ELSE = ("formation", "error", "track", "links")  # what is looked at first where no check says more


def telling(run: Run) -> list[str]:
    """Names of pictures, the most telling first: what failed checks look at, then what others do, then errors."""
    failed = [row for row in run.verdicts if not row["passed"]]
    passed = [row for row in run.verdicts if row["passed"] and row["signals"]]
    return [*_of(failed), *_of(passed), *_ELSE]


def _of(rows: Iterable[dict[str, Any]]) -> list[str]:
    found = []
    for row in rows:
        signals = [name for name in map(parse_name, row["signals"]) if name is not None]
        found += [_ERRORS.get(name.name, file_name(name)) for name in signals]
        if row["check"] in _OF_CHECKS:
            found.append(_OF_CHECKS[row["check"]])
    return found


_ERRORS = {"error.e_norm": "error", "error.formation_norm": "formation"}  # signals that have a picture of their own
