"""The figures of `fleet bench` as tables."""

from __future__ import annotations

from typing import Any

from rich.console import Console as Terminal
from rich.table import Table

from fleet.bench.fleets import netem_targets, step_targets, targets
from fleet.bench.journal import show_journals
from fleet.bench.start_up import start_up_table
from fleet.terminal.table import columns
from fleet.terminal.table import show as show_table


def show(figures: dict[str, Any], terminal: Terminal) -> None:
    """Print fleets, single steps and targets."""
    headings = {
        "N": 0, "a zenoh\nbarrier": 0, "b pipe\nbarrier": 0, "c\ndistributed": 0, "d\nin-process": 0,
        "c/a": 0, "c/d": 0, "c x\nreal": 1, "ready\n[s]": 2, "PSS\n[MB]": 3,
    }  # fmt: skip
    rows = [
        (
            str(row["vehicles"]),
            *(f"{row[key]:.0f}" for key in ("zenoh_barrier", "pipe_barrier", "distributed", "in_process")),
            *(f"{row[key]:.2f}" for key in ("c/a", "c/d", "x_real_time", "startup_s")),
            f"{row['pss_mb']:.1f}",
        )
        for row in figures["fleets"]
    ]
    show_table(columns(headings, rows), "ticks per second (Ts = 10 ms), PSS per agent", terminal, "--json FILE")
    single = Table(title="single steps, median us", title_justify="left", box=None, pad_edge=False, show_header=False)
    for name, cost in figures["steps_us"].items():
        single.add_row(name, f"{cost:.1f}")
    terminal.print(single)
    network = Table(title="the network core", title_justify="left", box=None, pad_edge=False, show_header=False)
    for name, value in figures["netem"].items():
        network.add_row(name, f"{value:.3f}" if value < 1 else f"{value:.0f}")
    terminal.print(network)
    show_journals(figures["journals"], terminal)
    terminal.print(start_up_table(figures["start_up"]))
    for line in [*targets(figures["fleets"]), *step_targets(figures["steps_us"]), *netem_targets(figures["netem"])]:
        terminal.print(line, highlight=False)
