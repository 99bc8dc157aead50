"""Are the limits that `fleet check` computes those of the simulation?

    python docs/examples/stability_borders.py          # more rows than linear-stability.md has; an hour
    python docs/examples/stability_borders.py --quick  # a few rows

Four vehicles start in formation but for a micrometre. Per graph, period of rounds and gain the fleet runs twice, with
the gain (or the delay) 5 % below the computed limit and 5 % above it, and the growth of its deviation is measured:
below the limit it must decay, above it grow. The limit of the simulation is where the rate of growth passes zero,
interpolated between the two.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from math import atan2, ceil, floor, hypot
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

import fleet
from fleet.analysis.stability import analyse
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

GRAPHS = {
    "path": "{shape: path, ahead: 1.0, behind: 0.8}",
    "ring": "{shape: ring, ahead: 1.0, behind: 0.8}",
    "star": "{shape: star}",
    "complete": "{shape: complete}",
    "directed path": '{edges: {"1->2": 1.0, "2->3": 1.0, "3->4": 1.0}}',
}
PERIODS_MS = (10, 100, 200)
GAINS = (0.3, 0.9)
PLACES = ((0.0, 0.0), (0.0, -10.0), (10.0, -10.0), (10.0, 0.0))
VELOCITY = (0.7, 0.1)
SMALL = 1e-6  # m, of a deviation
OFF = ((1.0, -0.5, 1.0), (-1.0, 1.0, -0.4), (0.5, 0.3, -1.0), (0.2, -1.0, 0.6))  # how the four deviate, times SMALL
TEXT = """\
title: A fleet in formation
vehicles: 4
duration: {duration} s
reference: {{start: 5 1 5 m, velocity: 0.7 0.1 0 m/s}}
formation: {{shape: grid}}
graph: {graph}
initial: {initial}
vehicle: {{surge_force: 20 N, pitch_moment: 20 N m, yaw_moment: 20 N m}}
on_death: abort
controller: {controller}
guidance: {{K0: {gain!r} {gain!r} {gain!r} 1/s}}
neighbours: {{extrapolate: {extrapolate}}}
network: {{period: {period} ms, links: {{"*": delay {delay}ms}}}}
"""


class Case(NamedTuple):
    """One fleet."""

    graph: str
    period_ms: int
    gain: float
    delay_ms: int = 0
    extrapolate: str = "neighbour"
    controller: str = "nbc"


def scenario(case: Case, duration: float = 10.0, small: float = SMALL) -> Scenario:
    """The fleet at its places, each vehicle off by a different small distance."""
    course, speed = atan2(VELOCITY[1], VELOCITY[0]), hypot(*VELOCITY)
    initial = []
    for (x, y), (dx, dy, dz) in zip(PLACES, OFF, strict=True):
        place = f"{5 + x + small * dx!r} {1 + y + small * dy!r} {5 + small * dz!r} m"
        initial.append(f"{{position: {place}, yaw: {course!r} rad, surge: {speed!r} m/s}}")
    values = case._asdict() | {
        "graph": GRAPHS[case.graph], "initial": "[" + ", ".join(initial) + "]", "duration": duration,
        "period": case.period_ms, "delay": case.delay_ms,
    }  # fmt: skip
    return parse_scenario(TEXT.format(**values), "border.yaml")


def formations(scenario: Scenario) -> np.ndarray:
    """How far each vehicle is from its place [m], shape (samples, vehicles, 3)."""
    with TemporaryDirectory() as folder, fleet.Run(scenario, log=f"{folder}/run.mcap") as run:
        run.to_end()
        log = fleet.open_log(f"{folder}/run.mcap")
        return np.stack([log[f"uuv/{i}/error"]["formation"] for i in range(1, scenario.vehicles + 1)], axis=1)


def growth(case: Case, duration: float = 120.0) -> float:
    """The rate [1/s] at which the deviation grows in a simulation; negative: it decays."""
    fleet_of_case = scenario(case, duration)
    formation = formations(fleet_of_case)
    if case.extrapolate == "hold":  # the fleet lags behind its places: what a deviation adds to that
        other = formations(scenario(case, duration, 0.0))
        both = min(len(formation), len(other))
        formation = formation[:both] - other[:both]
    deviation = np.linalg.norm(formation, axis=(1, 2))
    # From when the start is forgotten, until it is no longer small or is lost in rounding.
    end = int(np.argmax(~((deviation > 1e-12) & (deviation < 0.02)))) or len(deviation)
    begin = min(len(deviation) // 4, end // 2)
    blocks = [block.max() for block in np.array_split(deviation[begin:end], 12)]
    slope = np.polyfit(range(12), np.log(blocks), 1)[0]
    return float(slope * 12 / ((end - begin) * fleet_of_case.tick_ns / 1e9))


class Row(NamedTuple):
    """A border, computed and simulated."""

    case: Case
    what: str
    unit: str
    computed: float
    loop: str
    frequency_hz: float
    low: float  # 0.95 of it, in whole ticks where it is a delay
    high: float
    low_rate: float  # 1/s
    high_rate: float

    @property
    def holds(self) -> bool:
        """Whether the simulation decays below the computed border and grows above it."""
        return self.low_rate < 0.0 < self.high_rate

    @property
    def simulated(self) -> float:
        """Where the rate of growth passes zero; NaN when it does not."""
        if not self.holds or not np.isfinite(self.low_rate):
            return float("nan")
        return self.low - self.low_rate * (self.high - self.low) / (self.high_rate - self.low_rate)


def gain_row(case: Case, duration: float = 120.0) -> Row:
    """The border of the gain."""
    fleet = analyse(scenario(case)).at_most
    assert fleet is not None
    border = fleet.gain_border(case.gain)
    low, high = 0.95 * border, 1.05 * border
    rates = [growth(case._replace(gain=gain), duration) for gain in (low, high)]
    mode = fleet.mode(border)
    return Row(case, "gain", "1/s", border, *mode[::-1], low, high, rates[0], rates[1])


def delay_row(case: Case, duration: float = 120.0) -> Row | None:
    """The border of the delay; None when there is none."""
    fleet = analyse(scenario(case)).at_most
    assert fleet is not None
    border = fleet.delay_border(case.gain)
    if border is None or border == 1:
        return None
    tick = round(1e3 * fleet.tick_s)
    low, high = min(floor(0.95 * border), border - 1) * tick, max(ceil(1.05 * border), border + 1) * tick
    rates = [growth(case._replace(delay_ms=delay), duration) for delay in (low, high)]
    mode = fleet.mode(case.gain, border)
    computed = (border - 0.5) * tick / 1e3
    return Row(case, "delay", "s", computed, *mode[::-1], low / 1e3, high / 1e3, rates[0], rates[1])


def cases() -> Iterator[tuple[str, Case]]:
    """Every row of the table."""
    for graph in GRAPHS:
        for period in PERIODS_MS:
            yield "gain", Case(graph, period, 1.0)
            for gain in GAINS:
                yield "delay", Case(graph, period, gain)


def row(asked: tuple[str, Case]) -> Row | None:
    """One row of the table."""
    what, case = asked
    return gain_row(case) if what == "gain" else delay_row(case)


def line(found: Row) -> str:
    """A row in Markdown."""
    case = found.case
    gain = "" if found.what == "gain" else f"{case.gain:g}"
    off = f"{100.0 * (found.simulated / found.computed - 1.0):+.1f} %" if found.holds else "more than 5 %"
    cells = (
        case.graph, case.period_ms, found.what, gain, f"{found.computed:.3f} {found.unit}",
        f"{found.loop}, {found.frequency_hz:.2f} Hz", f"{found.low_rate:+.3f}", f"{found.high_rate:+.3f}", off,
    )  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few rows")
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args()
    table = list(cases())[:: 12 if asked.quick else 1]
    print("| graph | round [ms] | limit of | at K | computed | loop | rate at 0.95 | at 1.05 | simulated |")
    print("|---|---|---|---|---|---|---|---|---|")
    wrong = 0
    with ProcessPoolExecutor(asked.workers) as pool:
        for found in pool.map(row, table):
            if found is not None:
                print(line(found), flush=True)
                wrong += not found.holds
    print(f"\n{wrong} of them not within 5 %")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
