"""The tables of a report: headings and rows, which the page's template turns into HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from fleet.logs.payload_kinds import KindCount
from fleet.pictures.beliefs import beliefs
from fleet.pictures.runs import Run
from fleet.result.result import LinkAge, Result
from fleet.result.verdict import Verdict
from netem.causes import Cause
from netem.ledger import Account

_Name = TypeVar("_Name", int, str)
MOST_ROWS = 40  # of a table of vehicles or links
_ONLY_IF_ANY = ("duplicated", "in flight", "corrupted")  # columns that are left out where every link has a 0


class Mark(NamedTuple):
    """A cell with a word in the colour of a pass or of a failure."""

    good: bool
    word: str


class Table(NamedTuple):
    """Rows under headings, or without any; a cell is a `Mark`, or is shown as text."""

    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]


def side_by_side(runs: Sequence[Run], results: Sequence[Result | None]) -> Table:
    """A row per run: what one looks for first when runs are compared; None: the run has no result."""
    headings = (
        "run", "seed", "vehicles", "status", "checks passed", "slowest settle to 10 % [s]",
        "largest final formation error [m]", "surge effort, all [N s]", "delivered", "oldest heard [s]",
    )  # fmt: skip
    rows = []
    for run, result in zip(runs, results, strict=True):
        row: list[Any] = [run.label, run.log.run.get("seed", "-"), len(run.log.vehicles)]
        if result is None:
            rows.append([*row, *["-"] * (len(headings) - len(row))])
            continue
        good = sum(verdict.passed for verdict in result.checks)
        row += [
            Mark(result.passed, result.status.replace("_", " ")),
            f"{good} of {len(result.checks)}" if result.checks else "-",
        ]
        vehicles = list(result.vehicles.values())
        row += [
            _joined([one.settle_10pct_s for one in vehicles], max, "not settled"),
            _joined([one.formation_final_m for one in vehicles], max),
            _joined([one.effort_Ns for one in vehicles], sum),
        ]
        accounts = result.ledger.values()
        entered = sum(account.sent + account.duplicated - account.replaced for account in accounts)
        row.append(f"{sum(account.delivered for account in accounts) / entered:.1%}" if entered else "-")
        age = result.ages.get("*")
        rows.append([*row, f"{age.max_s:.4g}" if age else "-"])
    return Table(headings, rows)


def believed_errors(run: Run, vehicles: Iterable[str]) -> dict[str, float]:
    """The last formation error of each vehicle that has to navigate, as it believes it [m]."""
    known = ((i, beliefs(run.log, int(i))) for i in vehicles)
    return {i: float(one.formation_norm[-1]) for i, one in known if one is not None}


def _joined(numbers: Sequence[float | None], join: Callable[[list[float]], float], missing: str = "-") -> str:
    """One number for all vehicles; `missing`: what stands there if one of them has none."""
    known = [value for value in numbers if value is not None]
    return "-" if not numbers else f"{join(known):.4g}" if len(known) == len(numbers) else missing


def links_table(ledger: Mapping[str, Account], ages: Mapping[str, LinkAge]) -> Table:
    """Packets and ages of all links, or of the links with the oldest news; `ledger` and `ages` as in a result."""
    # What a modem never sent, because there were news, was not lost on the way.
    causes = sorted(
        {cause for account in ledger.values() for cause in account.lost}, key=lambda c: (c != Cause.REPLACED, c)
    )
    names = worst(ledger, {name: age.max_s for name, age in ages.items()})
    counted = ("sent", "duplicated", "delivered", "in_flight", "corrupted")
    rows = []
    for name in ["*", *names]:
        accounts = list(ledger.values()) if name == "*" else [ledger[name]]
        numbers = [sum(getattr(account, key) for account in accounts) for key in counted]
        losses = [sum(account.lost.get(cause, 0) for account in accounts) for cause in causes]
        age = ages.get(name)
        times = ["-"] * 3 if age is None else [f"{seconds:.3f}" for seconds in (age.mean_s, age.p95_s, age.max_s)]
        rows.append(("all" if name == "*" else name, *numbers, *losses, *times))
    headings = ("link", *(key.replace("_", " ") for key in counted),
                *(cause if cause == Cause.REPLACED else f"lost: {cause}" for cause in causes),
                "mean age [s]", "95 % [s]", "max [s]")  # fmt: skip
    kept = [k for k, heading in enumerate(headings) if heading not in _ONLY_IF_ANY or rows[0][k]]
    rows, headings = [tuple(row[k] for k in kept) for row in rows], tuple(headings[k] for k in kept)
    rows += rest(len(ledger) - len(names), "whose age stayed lower")
    return Table(headings, rows)


def kinds_table(kinds: Sequence[KindCount]) -> Table:
    """The packets by kind of payload."""
    rows = [
        (one.kind, one.packets, one.delivered, f"{one.delivered / one.packets:.1%}", f"{one.size / one.packets:.4g}")
        for one in kinds[:MOST_ROWS]
    ]
    left = rest(len(kinds) - len(rows), "of which there are fewer")
    return Table(("kind", "packets", "arrived whole", "share", "mean size [bytes]"), [*rows, *left])


def checks_table(verdicts: Sequence[Verdict]) -> Table:
    """The verdicts, failed checks on top."""
    rows = [
        (one.check, Mark(one.passed, "pass" if one.passed else "FAIL"), one.asked, one.found)
        for one in sorted(verdicts, key=lambda one: one.passed)
    ]
    return Table(("check", "verdict", "asked", "found"), rows)


def worst(rows: Mapping[_Name, Any], how_bad: Mapping[_Name, float]) -> list[_Name]:
    """The names of all rows, or of too many those of the worst, the worst first."""
    if len(rows) <= MOST_ROWS:
        return list(rows)
    return sorted(rows, key=lambda name: -how_bad.get(name, 0.0))[:MOST_ROWS]


def rest(count: int, which: str) -> list[tuple[str]]:
    """A row that says how many rows are left out, and which; none if none are."""
    return [(f"{count} more, {which}",)] if count else []


def number(key: str, value: Any) -> str:
    """A value of a vehicle's result."""
    if value is None:
        return "not settled" if key.startswith("settle") else "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
