"""The result of a run as tables for a terminal."""

from __future__ import annotations

from rich.console import Console as Terminal
from rich.markup import escape
from rich.table import Table

from fleet.run import Result, Status

MOST_ROWS = 20


def show(result: Result, terminal: Terminal) -> None:
    """Print vehicles, links, verdicts and where everything is."""
    values = result.values
    if values["vehicles"]:
        terminal.print(_vehicles(values["vehicles"]))
    if any(account["sent"] for account in values["ledger"].values()):
        terminal.print(_links(values["ledger"]))
    for verdict in result.verdicts:
        mark = "[green]pass[/]" if verdict.passed else "[red]FAIL[/]"
        terminal.print(
            f"{mark}  {verdict.check}: {verdict.asked}; found {verdict.found}", highlight=False, soft_wrap=True
        )
    for note in values["notes"]:
        terminal.print(f"note  {note}", markup=False, highlight=False, soft_wrap=True)
    wall = values["wall"]
    how = "in-process" if wall["in_process"] else f"distributed, ready in {wall['startup_s']:.2f} s"
    terminal.print(
        f"{values['sim_s']:g} s simulated in {wall['run_s']:.2f} s ({wall['x_real_time']:.1f} x real time, {how}); "
        f"{values['messages']} messages, digest {result.digest[:16]}",
        highlight=False,
        soft_wrap=True,
    )
    if result.status in (Status.BROKEN, Status.INTERRUPTED):
        terminal.print(f"[red]{'run broke' if result.status is Status.BROKEN else 'stopped'}[/]: ", end="")
        terminal.print(result.reason, markup=False, highlight=False, soft_wrap=True)
        for line in result.lines:
            terminal.print(line, markup=False, highlight=False, soft_wrap=True)
    terminal.print(str(result.directory), markup=False, highlight=False, soft_wrap=True)


def _vehicles(rows: dict[str, dict[str, float | None]]) -> Table:
    table = Table(title="vehicles", title_justify="left", box=None, pad_edge=False)
    for heading in (
        "UUV", "settle 10 % [s]", "settle 5 cm [s]", "RMS e, last 10 s [m]", "final error [m]",
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
        table.add_row("...", f"and {len(rows) - MOST_ROWS} more in result.json")
    return table


def _links(rows: dict[str, dict[str, object]]) -> Table:
    causes = sorted({cause for row in rows.values() for cause in row["lost"]})  # type: ignore[attr-defined]
    table = Table(title="packets per directed link", title_justify="left", box=None, pad_edge=False)
    for heading in (
        "link",
        "sent",
        "duplicated",
        "delivered",
        *(f"lost: {c}" for c in causes),
        "in flight",
        "corrupted",
    ):
        table.add_column(escape(heading), justify="right")
    for name, row in list(rows.items())[:MOST_ROWS]:
        lost = [str(row["lost"].get(cause, 0)) for cause in causes]  # type: ignore[attr-defined]
        table.add_row(
            name,
            str(row["sent"]),
            str(row["duplicated"]),
            str(row["delivered"]),
            *lost,
            str(row["in_flight"]),
            str(row["corrupted"]),
        )
    if len(rows) > MOST_ROWS:
        table.add_row("...", f"{len(rows) - MOST_ROWS} more")
    return table


def _number(value: float | None, form: str) -> str:
    return "never" if value is None else format(value, form)
