"""The tables of a report: headings and rows, which the page's template turns into HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from fleet.logs.payload_kinds import KindCount
from fleet.pictures.runs import Run
from netem.causes import Cause

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


def side_by_side(runs: Sequence[Run], results: Sequence[Mapping[str, Any] | None]) -> Table:
    """A row per run: what one looks for first when runs are compared; `results` as in result.json, None without one."""
    headings = (
        "run", "seed", "vehicles", "status", "checks passed", "slowest settle to 10 % [s]",
        "largest final formation error [m]", "surge effort, all [N s]", "delivered", "oldest heard [s]",
    )  # fmt: skip
    rows = []
    for run, values in zip(runs, results, strict=True):
        row: list[Any] = [run.label, run.log.run.get("seed", "-"), len(run.log.vehicles)]
        if values is None:
            rows.append([*row, *["-"] * (len(headings) - len(row))])
            continue
        checks, status = values["checks"], values["status"]
        good = sum(check["passed"] for check in checks)
        row += [Mark(status == "pass", status.replace("_", " ")), f"{good} of {len(checks)}" if checks else "-"]
        vehicles = list(values["vehicles"].values())
        settle = [vehicle["settle_10pct_s"] for vehicle in vehicles]
        row.append("-" if not settle else "not settled" if None in settle else f"{max(settle):.4g}")
        for key, of_all in (("formation_final_m", max), ("effort_Ns", sum)):
            numbers = [vehicle[key] for vehicle in vehicles]
            row.append("-" if None in numbers or not numbers else f"{of_all(numbers):.4g}")
        accounts = values["ledger"].values()
        entered = sum(a["sent"] + a["duplicated"] - a["lost"].get(Cause.REPLACED, 0) for a in accounts)
        row.append(f"{sum(a['delivered'] for a in accounts) / entered:.1%}" if entered else "-")
        age = values["ages"].get("*")
        rows.append([*row, f"{age['max_s']:.4g}" if age else "-"])
    return Table(headings, rows)


def links_table(ledger: Mapping[str, Any], ages: Mapping[str, Any]) -> Table:
    """Packets and ages of all links, or of those that grew oldest; `ledger` and `ages` as in result.json."""
    # What a modem never sent, because there were news, was not lost on the way.
    causes = sorted(
        {cause for account in ledger.values() for cause in account["lost"]}, key=lambda c: (c != Cause.REPLACED, c)
    )
    names = worst(ledger, {name: age["max_s"] for name, age in ages.items()})
    counted = ("sent", "duplicated", "delivered", "in_flight", "corrupted")
    rows = []
    for name in ["*", *names]:
        accounts = list(ledger.values()) if name == "*" else [ledger[name]]
        numbers = [sum(account[key] for account in accounts) for key in counted]
        losses = [sum(account["lost"].get(cause, 0) for account in accounts) for cause in causes]
        age = ages.get(name)
        times = ["-"] * 3 if age is None else [f"{age[key]:.3f}" for key in ("mean_s", "p95_s", "max_s")]
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


def checks_table(checks: Sequence[Mapping[str, Any]]) -> Table:
    """The verdicts, failed checks on top; `checks` as in result.json."""
    rows = [
        (check["check"], Mark(check["passed"], "pass" if check["passed"] else "FAIL"), check["asked"], check["found"])
        for check in sorted(checks, key=lambda check: bool(check["passed"]))
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
    """A value of result.json."""
    if value is None:
        return "not settled" if key.startswith("settle") else "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
