"""The figures of `fleet bench` as tables, and changes since another measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rich.console import Console as Terminal

from fleet.bench.figures import Figure, FiguresComparison, Measured
from fleet.bench.fleets import CPU, DISTRIBUTED, IN_PROCESS, PIPES, PSS, READY, TICK_S, ZENOH, goals
from fleet.bench.journal import show_journals
from fleet.bench.start_up import PYTHON
from fleet.terminal.table import TerminalColumn, columns
from fleet.terminal.table import show as show_table

_ELSEWHERE = "-o FILE"


def show(measured: Measured, terminal: Terminal) -> None:
    """Print all figures: of repeats the best sample, and the middle one of ratios."""
    groups: dict[str, list[Figure]] = {}
    for figure in measured.figures:
        groups.setdefault(figure.name.partition(": ")[0], []).append(figure)
    fleets = {name: {figure.name.partition(": ")[2]: figure for figure in of} for name, of in groups.items()
              if name.startswith("N = ")}  # fmt: skip
    _show_fleets(fleets, terminal)
    show_journals([_journal(name, of) for name, of in fleets.items()], terminal)
    for name, of in groups.items():
        if name not in fleets:
            _show_group(name, of, terminal)
    for line in goals(measured):
        terminal.print(line, highlight=False)


def _show_fleets(fleets: dict[str, dict[str, Figure]], terminal: Terminal) -> None:
    headings = {
        "N": 0, "a zenoh\nbarrier": 0, "b pipe\nbarrier": 0, "c\ndistributed": 0, "d\nin-process": 0,
        "c/a": 0, "c x\nreal": 1, "d x\nreal": 1, "d CPU\n[us]": 2, "ready\n[s]": 3, "PSS\n[MB]": 4,
    }  # fmt: skip
    rows = [
        (
            name.removeprefix("N = "),
            *(f"{of[key].best:.0f}" for key in (ZENOH, PIPES, DISTRIBUTED, IN_PROCESS)),
            f"{of[DISTRIBUTED].ratio:.2f}",
            *(f"{of[key].best * TICK_S:.2f}" for key in (DISTRIBUTED, IN_PROCESS)),
            f"{of[CPU].best:.0f}",
            f"{of[READY].best:.2f}",
            f"{of[PSS].best:.1f}" if PSS in of else "-",
        )
        for name, of in fleets.items()
    ]
    title = "ticks per second (Ts = 10 ms), CPU time of a tick, PSS of an agent"
    show_table(columns(headings, rows), title, terminal, _ELSEWHERE)


def _journal(name: str, of: dict[str, Figure]) -> dict[str, float]:
    journal = {key.removeprefix("journal "): figure.best for key, figure in of.items() if key.startswith("journal ")}
    return {"vehicles": int(name.removeprefix("N = ")), **journal}


def _show_group(name: str, figures: Sequence[Figure], terminal: Terminal) -> None:
    """One line per figure: its best sample; of start-up also its ratio to Python's own."""
    cells = [
        (
            figure.name.partition(": ")[2],
            f"{figure.best:.0f}" if figure.best >= 1000 else f"{figure.best:.3g}",
            figure.unit,
            f"{figure.ratio:.1f} x {PYTHON}" if figure.baseline == PYTHON else "",
        )
        for figure in figures
    ]
    headings = {name: 0, "best": 0, "unit": 0} | ({"ratio": 1} if any(cell[3] for cell in cells) else {})
    rows = [cell[: len(headings)] for cell in cells]
    show_table(_left(columns(headings, rows), name, "unit"), "", terminal, _ELSEWHERE)


def _left(columns: Sequence[TerminalColumn], *headings: str) -> list[TerminalColumn]:
    """The columns, those of these headings aligned to the left."""
    return [replace(column, justify="left") if column.heading in headings else column for column in columns]


def show_comparison(found: FiguresComparison, terminal: Terminal) -> None:
    """Print what changed, worst first, and why the two may not be comparable."""
    for warning in found.warnings:
        terminal.print(f"warning: {warning}", highlight=False, markup=False)
    if found.missing:
        names = ", ".join(found.missing[:3]) + (f" and {len(found.missing) - 3} more" if len(found.missing) > 3 else "")
        terminal.print(f"not compared, since only one has them: {names}", highlight=False, markup=False)
    changed = sorted((c for c in found.changes if c.verdict != "same"), key=lambda change: -change.times_slower)
    if changed:
        rows = [
            (
                change.verdict,
                change.name,
                f"{change.factor:.2f} x",
                change.compared,
                *(f"{value:.3g}" for value in (change.old, change.new)),
                f"{change.noise:.0%}",
            )
            for change in changed
        ]
        headings = {"": 0, "figure": 0, "by": 0, "compared": 4, "then": 2, "now": 2, "noise": 3}
        title = f"compared with {found.with_}"
        show_table(_left(columns(headings, rows), "", "figure", "compared"), title, terminal, "--json")
    same = len(found.changes) - len(changed)
    slower = len(found.slower)
    terminal.print(
        f"{slower} slower, {len(changed) - slower} faster, {same} the same within the noise", highlight=False
    )
