"""The figures of `fleet bench` as tables."""

from __future__ import annotations

from typing import Any

from rich.console import Console as Terminal
from rich.table import Table

from fleet.bench.fleets import netem_targets, step_targets, targets
from fleet.bench.journal import show_rows
from fleet.bench.start_up import start_up_table


def show(figures: dict[str, Any], terminal: Terminal) -> None:
    """Print fleets, single steps and targets."""
    table = Table(title="ticks per second (Ts = 10 ms)", title_justify="left", box=None, pad_edge=False)
    for heading in (
        "N", "a zenoh barrier", "b pipe barrier", "c distributed", "d in-process",
        "c/a", "c/d", "c x real time", "ready s", "PSS MB/agent",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for row in figures["fleets"]:
        speeds = [row[key] for key in ("zenoh_barrier", "pipe_barrier", "distributed", "in_process")]
        table.add_row(
            str(row["vehicles"]),
            *(f"{speed:.0f}" for speed in speeds),
            *(f"{row[key]:.2f}" for key in ("c/a", "c/d", "x_real_time", "startup_s")),
            f"{row['pss_mb']:.1f}",
        )
    terminal.print(table)
    single = Table(title="single steps, median us", title_justify="left", box=None, pad_edge=False, show_header=False)
    for name, cost in figures["steps_us"].items():
        single.add_row(name, f"{cost:.1f}")
    terminal.print(single)
    network = Table(title="the network core", title_justify="left", box=None, pad_edge=False, show_header=False)
    for name, value in figures["netem"].items():
        network.add_row(name, f"{value:.3f}" if value < 1 else f"{value:.0f}")
    terminal.print(network)
    terminal.print(show_rows(figures["journals"]))
    terminal.print(start_up_table(figures["start_up"]))
    for line in [*targets(figures["fleets"]), *step_targets(figures["steps_us"]), *netem_targets(figures["netem"])]:
        terminal.print(line, highlight=False)
