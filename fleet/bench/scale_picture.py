"""The rows of `fleet bench scale` as a table, line by line, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from fleet.bench.scale import ROLES, ScaleRow
from fleet.palette import COLOURS
from fleet.pictures.style import COLUMN_IN, DPI, NORMAL, STYLES, THIN

HEADING = (
    "CPU time per agent and tick [us]; tick and ready on the wall clock; PSS\n"
    "   N  per  tick  in-process  distributed  agents  world  netem  console  x real  ready  agent   all\n"
    "     proc. [ms]                                                           time    [s]   [MB]  [MB]"
)


def line(row: ScaleRow) -> str:
    """A row below `HEADING`."""
    us = row.distributed_us
    return (
        f"{row.vehicles:4d} {row.per_process:4d} {row.tick_ms:5g} {row.in_process_us:11.0f} {row.total_us:12.0f} "
        f"{us['agents']:7.0f} {us['world']:6.0f} {us['netem']:6.0f} {us['console']:8.0f} {row.x_real_time:7.2f} "
        f"{row.ready_s:6.1f} {row.agent_mb:6.1f} {row.all_mb:5.0f}"
    )


def draw(rows: Sequence[ScaleRow], path: Path) -> None:
    """CPU time per agent and tick over the number of vehicles, as a PNG."""
    figure = Figure(figsize=(COLUMN_IN, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    n = [row.vehicles for row in rows]
    lines = {
        "distributed": [row.total_us for row in rows],
        **{role: [row.distributed_us[role] for row in rows] for role in reversed(ROLES)},
        "in process": [row.in_process_us for row in rows],
    }
    for k, (name, values) in enumerate(lines.items()):
        width = THIN if name in ROLES else NORMAL
        ax.plot(n, values, marker="o", markersize=3, label=name, linewidth=width,
                color=COLOURS[k % len(COLOURS)], linestyle=STYLES[k % len(STYLES)])  # fmt: skip
    ax.set_xscale("log")
    ax.set_xticks(n, [str(value) for value in n])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_ylim(0.0, None)
    ax.set_xlabel("vehicles")
    ax.set_ylabel("CPU time per agent and tick [us]")
    ax.grid(alpha=0.4)
    figure.legend(loc="outside upper center", ncols=3)
    figure.savefig(path, dpi=DPI)
