"""`fleet bench real`: the number of vehicles and the rate from which a wall clock is too fast for this machine.

Every fleet is run on a wall clock, and the same scenario once in lockstep, which never depends on the machine: the
same bytes, only later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from rich.console import Console as Terminal

from fleet.analysis.punctuality import MOST_MISSED, missed_share, moved_share
from fleet.bench.measured_run import measured_run
from fleet.execution.options import Options
from fleet.result.result import Result
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.terminal.table import columns, show
from netem.private_folder import PrivateFolder
from netem.vehicle_clock import Clock


class WallClockRow(Struct, frozen=True):
    """One fleet at one rate."""

    vehicles: Annotated[int, Meta(description="Fleet size.")]
    speed: Annotated[float, Meta(description="Times real time that was asked [1].")]
    ticks_per_s: Annotated[float, Meta(description="Ticks of that rate [1/s].")]
    label: Annotated[str, Meta(description="on time, or degraded.")]
    missed: Annotated[float, Meta(description="Share of its ticks that the worst agent missed [1].")]
    moved: Annotated[
        float, Meta(description="Total move of the clock because the world was late, as a share of the run [1].")
    ]
    answer_p99_ms: Annotated[float, Meta(description="99th percentile of the answers of the slowest agent [ms].")]
    overdue: Annotated[float, Meta(description="Share of the deliveries that were used too late [1].")]
    same_bytes: Annotated[bool, Meta(description="Whether the log has the same bytes as in lockstep.")]
    lockstep_x: Annotated[float, Meta(description="Times real time that lockstep makes [1].")]
    fit: Annotated[bool, Meta(description="Whether a run would pass with the default tolerance.")]


class OnWallClock(Struct):
    """`fleet bench real --json`: where a wall clock is too fast for this machine."""

    rows: Annotated[list[WallClockRow], Meta(description="Each fleet at each rate.")]


def measure_wall_clock(
    sizes: Sequence[int], speeds: Sequence[float], seconds: float, say: Callable[[str], None]
) -> list[WallClockRow]:
    """Run every fleet at every speed, `seconds` of simulated time each.

    Raises:
        FleetError: a run broke.
    """
    rows = []
    with PrivateFolder("bench") as folder:
        for n in sizes:
            scenario = load_scenario(
                "paper", [f"vehicles={n}", f"duration={seconds} s", "checks={}", "log.snapshot=0 s"]
            )
            say(f"N = {n}: lockstep")
            same = measured_run(scenario, Options(folder, quiet=True), checked=False)
            for speed in speeds:
                say(f"N = {n}: {speed:g} x real time")
                timed = measured_run(scenario, _on_wall_clock(folder, speed), checked=False)
                rows.append(_row(n, speed, scenario, timed, same))
    return rows


def _on_wall_clock(folder: Path, speed: float) -> Options:
    return Options(folder, quiet=True, clock=Clock.REAL, speed=speed, most_missed=1.0)


def _row(n: int, speed: float, scenario: Scenario, found: Result, same: Result) -> WallClockRow:
    timing = found.timing
    assert timing is not None  # the clock is real, and the run came to its end
    network = timing.netem
    missed, moved = missed_share(timing), moved_share(timing)
    return WallClockRow(
        n,
        speed,
        speed * 1e9 / scenario.tick_ns,
        timing.label,
        missed,
        moved,
        max(row.response.p99_ms for row in timing.vehicles.values()),
        network.overdue / max(1, network.hop.count),
        found.digest == same.digest,
        same.wall.x_real_time,
        max(missed, moved) <= MOST_MISSED,
    )


def show_wall_clock(rows: Sequence[WallClockRow], terminal: Terminal) -> None:
    """Print the rows as a table."""
    headings = {
        "N": 0, "x real": 0, "ticks/s": 0, "label": 0, "ticks\nmissed": 0, "clock\nmoved": 1, "answer\np99 [ms]": 0,
        "overdue": 2, "same\nbytes": 4, "lockstep\nx real": 3,
    }  # fmt: skip
    cells = [
        (
            str(row.vehicles),
            f"{row.speed:g}",
            f"{row.ticks_per_s:g}",
            row.label if row.fit or row.label == "on time" else f"{row.label} (fails)",
            f"{row.missed:.2%}",
            f"{row.moved:.1%}",
            f"{row.answer_p99_ms:.2g}",
            f"{row.overdue:.1%}",
            "yes" if row.same_bytes else "no",
            f"{row.lockstep_x:.1f}",
        )
        for row in rows
    ]
    show(columns(headings, cells), "on a wall clock (Ts = 10 ms)", terminal, "--json")
