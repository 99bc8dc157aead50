"""A failure is made twice before a search reports it: a run is a function of scenario and seed, so both must agree."""

from __future__ import annotations

from typing import Any

from fleet.study.one_run import FAILED, JUDGED, Task, failed_checks
from fleet.study.plan import run_key

Row = dict[str, Any]


def repeat_of(task: Task) -> Task:
    """The same run once more."""
    return task._replace(key=run_key(f"{task.key}\nagain"))


def compared(first: Row, again: Row) -> Row:
    """The row of a run that failed, and was repeated; if the two disagree, a row without a result that says so."""
    if again["status"] in JUDGED and failed_checks(first) == failed_checks(again):
        return first
    known = {key: first[key] for key in ("key", "point", "seed", "version", "cores") if key in first}
    return known | {"status": FAILED, "reason": _reason(first, again)}


def _reason(first: Row, again: Row) -> str:
    failed = ", ".join(failed_checks(first))
    if again["status"] not in JUDGED:
        got = f"had no result when it was repeated: {again['reason']}"
    else:
        got = f"failed {', '.join(failed_checks(again)) or 'none'} when it was repeated"
    logs = "the same" if first.get("digest") == again.get("digest") else "different"
    text = f"not reproduced: the run with seed {first['seed']} failed {failed}, and {got}, with {logs} log"
    return f"{text}. One of the scenario's plug-ins depends on more than the seed, or this is a defect of uuv-fleet"
