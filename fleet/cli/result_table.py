"""The result of a run as tables for a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console as Terminal
from rich.markup import escape
from rich.table import Table

from fleet.analysis.preflight import large_log_hint
from fleet.analysis.punctuality import summary
from fleet.recorder.metrics import WorstAndMedian
from fleet.run.execute import Result, Status
from netem.causes import Cause

MOST_ROWS = 20


def show(result: Result, terminal: Terminal) -> None:
    """Print vehicles, links, verdicts and where everything is."""
    values = result.values
    if values["vehicles"]:
        terminal.print(_vehicles(values["vehicles"]))
    if len(values["vehicles"]) > 1:
        terminal.print(
            f"formation error at the end: {WorstAndMedian(**values['formation'])}", highlight=False, soft_wrap=True
        )
    if any(account["sent"] for account in values["ledger"].values()):
        terminal.print(_links(values["ledger"], values["ages"]))
    for verdict in result.verdicts:
        mark = "[green]pass[/]" if verdict.passed else "[red]FAIL[/]"
        terminal.print(
            f"{mark}  {verdict.check}: {verdict.asked}; found {verdict.found}", highlight=False, soft_wrap=True
        )
    notes = values["notes"]
    for note in notes[:MOST_ROWS]:
        terminal.print(f"note  {note}", markup=False, highlight=False, soft_wrap=True)
    if len(notes) > MOST_ROWS:
        terminal.print(f"note  ... and {len(notes) - MOST_ROWS} more in result.json", highlight=False)
    if "timing" in values:
        terminal.print(summary(values["timing"], values["timing"]["speed"]), highlight=False, soft_wrap=True)
    wall, size = values["wall"], values["log_bytes"]
    how = "in-process" if wall["in_process"] else f"distributed, ready in {wall['startup_s']:.2f} s"
    terminal.print(
        f"{values['sim_s']:g} s simulated in {wall['run_s']:.2f} s ({wall['x_real_time']:.1f} x real time, {how}); "
        f"{values['messages']} messages, {f'{size / 1e6:.1f} MB' if size else 'no log'}, digest {result.digest[:16]}",
        highlight=False,
        soft_wrap=True,
    )
    if hint := large_log_hint(size / 1e6):
        terminal.print(f"note  the log is large: {hint}", markup=False, highlight=False, soft_wrap=True)
    if result.status in (Status.BROKEN, Status.INTERRUPTED, Status.HUNG_UP):
        terminal.print(f"[red]{'run broke' if result.status is Status.BROKEN else 'stopped'}[/]: ", end="")
        terminal.print(result.reason, markup=False, highlight=False, soft_wrap=True)
        for line in result.lines:
            terminal.print(line, markup=False, highlight=False, soft_wrap=True)
    terminal.print(str(result.directory), markup=False, highlight=False, soft_wrap=True)


def _vehicles(rows: dict[str, dict[str, float | None]]) -> Table:
    table = Table(title="vehicles", title_justify="left", box=None, pad_edge=False)
    for heading in (
        "UUV", "settle 10 % [s]", "settle 5 cm [s]", "RMS e, last 10 s [m]", "final formation error [m]",
        "surge effort [N s]", "max u_cmd [m/s]",
    ):  # fmt: skip
        table.add_column(escape(heading), justify="right")
    for i, row in list(rows.items())[:MOST_ROWS]:
        table.add_row(
            i,
            _number(row["settle_10pct_s"], ".2f"),
            _number(row["settle_5cm_s"], ".2f"),
            _number(row["e_rms_m"], ".4f"),
            _number(row["formation_final_m"], ".4f"),
            _number(row["effort_Ns"], ".1f"),
            "-" if row["u_cmd_max_mps"] is None else format(row["u_cmd_max_mps"], ".2f"),
        )
    if len(rows) > MOST_ROWS:
        table.add_row("...", f"{len(rows) - MOST_ROWS} more")
    return table


def _links(rows: dict[str, dict[str, Any]], ages: dict[str, dict[str, float]]) -> Table:
    """Packets and ages of the links: of all, or of those with the oldest information; columns of zeros are left out."""
    lost = sorted({cause for row in rows.values() for cause in row["lost"]} - {Cause.REPLACED})
    numbers = {
        name: {
            "sent": row["sent"],
            "duplicated": row["duplicated"],
            "replaced": row["lost"].get(Cause.REPLACED, 0),  # by newer data before it was sent: not lost on the way
            "delivered": row["delivered"],
            **{f"lost: {cause}": row["lost"].get(cause, 0) for cause in lost},
            "in flight": row["in_flight"],
            "corrupted": row["corrupted"],
        }
        for name, row in rows.items()
    }
    total = {key: sum(row[key] for row in numbers.values()) for key in next(iter(numbers.values()))}
    headings = [key for key in total if total[key] or key in ("sent", "delivered")]
    shown = list(rows)
    if len(rows) > MOST_ROWS:
        shown = sorted(rows, key=lambda name: -ages[name]["max_s"] if name in ages else 0.0)[:MOST_ROWS]
    title = "packets per directed link, age of what was heard last"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("link", *headings, "mean age [s]", "p95 [s]", "max [s]"):
        table.add_column(escape(heading), justify="right")
    for name, row, age in [("all", total, ages.get("*")), *((name, numbers[name], ages.get(name)) for name in shown)]:
        times = ["-"] * 3 if age is None else [f"{age[key]:.3f}" for key in ("mean_s", "p95_s", "max_s")]
        table.add_row(name, *(str(row[heading]) for heading in headings), *times)
    if len(rows) > MOST_ROWS:
        table.add_row("...", f"{len(rows) - MOST_ROWS} more")
    return table


def _number(value: float | None, form: str) -> str:
    return "not settled" if value is None else format(value, form)
