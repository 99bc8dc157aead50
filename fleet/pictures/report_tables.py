"""The tables of a report, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from fleet.pictures.runs import Run
from netem.causes import Cause

MOST_ROWS = 40  # of a table of links
_ONLY_IF_ANY = ("duplicated", "in flight", "corrupted")  # columns that are left out where every link has a 0


def side_by_side(runs: Sequence[Run], results: Sequence[Mapping[str, Any] | None]) -> str:
    """A row per run: what one looks for first when runs are compared; `results` as in result.json, None without one."""
    headings = (
        "run", "seed", "vehicles", "status", "checks passed", "slowest settle to 10 % [s]", "largest final error [m]",
        "surge effort, all [N s]", "delivered", "oldest heard [s]",
    )  # fmt: skip
    rows = []
    for run, values in zip(runs, results, strict=True):
        row: list[Any] = [run.label, run.log.run.get("seed", "-"), len(run.log.vehicles)]
        if values is None:
            rows.append([*row, *["-"] * (len(headings) - len(row))])
            continue
        checks, status = values["checks"], values["status"]
        good = sum(check["passed"] for check in checks)
        row += [mark(status == "pass", status.replace("_", " ")), f"{good} of {len(checks)}" if checks else "-"]
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
    return table(headings, rows)


class Html(str):
    """Text that is HTML already."""


def mark(good: bool, word: str) -> Html:
    """A word in the colour of a pass or of a failure."""
    return Html(f'<span class="{"pass" if good else "fail"}">{escape(word)}</span>')


def links_table(ledger: Mapping[str, Any], ages: Mapping[str, Any]) -> str:
    """Packets and ages of all links, or of those that grew oldest; `ledger` and `ages` as in result.json."""
    # What a modem never sent, because there were news, was not lost on the way.
    causes = sorted(
        {cause for account in ledger.values() for cause in account["lost"]}, key=lambda c: (c != Cause.REPLACED, c)
    )
    names = sorted(ledger, key=lambda name: -ages[name]["max_s"] if name in ages else 0.0)
    names = list(ledger) if len(ledger) <= MOST_ROWS else names[:MOST_ROWS]
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
    if len(ledger) > len(names):
        rows.append((f"{len(ledger) - len(names)} more, whose age stayed lower",))
    return table(headings, rows)


def number(key: str, value: Any) -> str:
    """A value of result.json."""
    if value is None:
        return "not settled" if key.startswith("settle") else "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def table(headings: Sequence[str], rows: Iterable[Sequence[Any]], kind: str = "") -> str:
    """Rows under headings; `kind` is the class of the style sheet."""

    def cell(value: Any) -> str:
        return value if isinstance(value, Html) else escape(str(value))

    lines = [f'<div class="scroll"><table class="{kind}">']
    if headings:
        lines.append("<tr>" + "".join(f"<th>{escape(heading)}</th>" for heading in headings) + "</tr>")
    lines += ["<tr>" + "".join(f"<td>{cell(value)}</td>" for value in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table></div>"])
