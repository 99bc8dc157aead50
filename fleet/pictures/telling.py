"""Which picture shows best what a run came to: the one at the top of a report."""

from __future__ import annotations

from collections.abc import Iterable

from fleet.pictures.any_signal import file_name
from fleet.pictures.runs import Run
from fleet.result.verdict import Verdict
from fleet.scenario.sections.signals import parse_name

_OF_CHECKS = {
    "formation_error": "formation", "consensus_error": "error", "recovery_time": "formation", "tumbled": "formation",
    "min_separation": "track", "deaths": "track", "max_age": "ages", "connected": "links", "ledger": "links",
    "middleware_loss": "links",
}  # fmt: skip
_ELSE = ("formation", "error", "track", "links")  # what is looked at first where no check says more


def telling(run: Run) -> list[str]:
    """Names of pictures, the most telling first: what failed checks look at, then what others do, then errors."""
    failed = [verdict for verdict in run.verdicts if not verdict.passed]
    passed = [verdict for verdict in run.verdicts if verdict.passed and verdict.signals]
    return [*_of(failed), *_of(passed), *_ELSE]


def _of(verdicts: Iterable[Verdict]) -> list[str]:
    found = []
    for verdict in verdicts:
        signals = [name for name in map(parse_name, verdict.signals) if name is not None]
        found += [_ERRORS.get(name.name, file_name(name)) for name in signals]
        if verdict.check in _OF_CHECKS:
            found.append(_OF_CHECKS[verdict.check])
    return found


_ERRORS = {"error.e_norm": "error", "error.formation_norm": "formation"}  # signals that have a picture of their own
