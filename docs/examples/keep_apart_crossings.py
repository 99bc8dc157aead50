"""Does `keep_apart` keep its distance in any crossing, and does no vehicle tumble?

    python docs/examples/keep_apart_crossings.py             # the table of docs/background/keep-apart.md: 200 crossings
    python docs/examples/keep_apart_crossings.py --runs 20   # the first 20 of them
    python docs/examples/keep_apart_crossings.py --set keep_apart=null  # what happens without

Each crossing is drawn from its number: 2 to 5 vehicles swap places through about one point, which moves on with the
formation. Drawn are the course of the fleet (any) and its speed, the places before and after with their depths, the
heading of each vehicle at the start, and the delay and the loss of the links. The profile is *hardened*.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations
from math import cos, degrees, dist, pi, sin
from typing import Any, NamedTuple

import numpy as np

from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import parse_scenario

SEED = 22
DISTANCE = 3.0  # m, that is asked for
BEGIN, OVER, REST = 2, 50, 8  # s: when they begin to swap places, how long that takes, and what follows
DEEP = np.array([0.0, 0.0, 20.0])  # m, where the formation is
FASTEST = 15.0 / 8.0  # of a smooth change of places, over its mean
TEXT = """\
title: Crossing {number}
vehicles: {vehicles}
duration: {duration} s
seed: {number}
reference: {{start: 0 0 20 m, velocity: {north:.4f} {east:.4f} 0 m/s}}
formation: {{offsets: [{before}], changes: [{{at: {begin} s, over: {over} s, offsets: [{after}]}}]}}
graph: {{shape: complete}}
initial: [{initial}]
controller: nboc
profile: hardened
guidance: {{rho_lo: -1.4 -1.4 -0.4 m/s, rho_hi: 1.4 1.4 0.4 m/s}}
keep_apart: {{distance: {distance} m}}
neighbours: {{extrapolate: reference}}
network: {{period: 100 ms, links: {{"*": delay {delay}ms loss {loss}%}}}}
log: none
checks: {{min_separation: {{above: {distance} m}}}}
"""


class Outcome(NamedTuple):
    """What came of one crossing."""

    number: int
    vehicles: int
    least: float  # m, distance of any two vehicles at any tick
    steepest: float  # deg, pitch of any vehicle at any tick
    tumbles: int


def crossing(number: int) -> str:
    """The scenario of a number, as YAML."""
    rng = np.random.default_rng([SEED, number])
    count = int(rng.integers(2, 6))
    course, speed = rng.uniform(0.0, 2.0 * pi), rng.uniform(0.6, 0.9)
    ahead = np.array([cos(course), sin(course), 0.0])
    while True:
        bearing = rng.uniform(0.0, 2.0 * pi, count)
        before = _places(bearing, rng)
        after = _places(bearing + pi + rng.uniform(-0.3, 0.3, count), rng)
        along = speed + (after - before) @ ahead * FASTEST / OVER
        apart = min(dist(p, q) for places in (before, after) for p, q in combinations(places, 2))
        if apart > 2.0 * DISTANCE and along.min() > 0.25 and along.max() < 1.2:
            break
    yaw = np.degrees(course + rng.uniform(-0.25 * pi, 0.25 * pi, count))
    initial = (
        f"{{position: {_text(p + DEEP)}, yaw: {angle:.2f} deg, surge: 0.7 m/s}}" for p, angle in zip(before, yaw)
    )
    return TEXT.format(
        number=number, vehicles=count, duration=BEGIN + OVER + REST, begin=BEGIN, over=OVER, distance=DISTANCE,
        north=speed * ahead[0], east=speed * ahead[1], before=", ".join(map(_text, before)),
        after=", ".join(map(_text, after)), initial=", ".join(initial), delay=rng.integers(0, 401),
        loss=rng.integers(0, 41),
    )  # fmt: skip


def _places(bearing: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A place for each bearing [rad]: 6 to 10 m from the middle, and up to 1.5 m above or below it [m, NED]."""
    away = rng.uniform(6.0, 10.0, len(bearing))
    return np.column_stack([away * np.cos(bearing), away * np.sin(bearing), rng.uniform(-1.5, 1.5, len(bearing))])


def _text(place: np.ndarray) -> str:
    return "{:.3f} {:.3f} {:.3f} m".format(*place)


class Seen:
    """Watches the vehicles of a run."""

    def __init__(self) -> None:
        self.least, self.steepest = float("inf"), 0.0

    def frame(self, frame: Any, commands: Mapping[int, Any], errors: Mapping[int, Any]) -> None:
        vehicles = frame.vehicles
        self.steepest = max(self.steepest, *(abs(degrees(vehicle.eta[3])) for vehicle in vehicles))
        self.least = min(self.least, *(dist(p.eta[:3], q.eta[:3]) for p, q in combinations(vehicles, 2)))


def crossed(number: int, changes: Sequence[str] = ()) -> Outcome:
    """Run the crossing of a number, with changes in the words of `--set`."""
    scenario = parse_scenario(crossing(number), f"crossing-{number}.yaml", changes)
    seen = Seen()
    result = run_loaded(scenario, watcher=seen)
    if result.reason:
        raise RuntimeError(f"crossing {number}: {result.reason}")
    tumbles = sum(verdict.value for verdict in result.checks if verdict.check == "tumbled")
    return Outcome(number, scenario.vehicles, seen.least, seen.steepest, int(tumbles))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, metavar="N")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    asked = parser.parse_args()
    found: list[Outcome] = []
    with ProcessPoolExecutor() as pool:
        for one in pool.map(partial(crossed, changes=asked.changes), range(asked.runs)):
            found.append(one)
            if one.tumbles or one.least < DISTANCE:
                print(f"crossing {one.number}: {one.tumbles} tumbles, {one.least:.2f} m apart", file=sys.stderr)
    print("| vehicles | crossings | with a tumble | nearer than 3 m | least distance | steepest pitch |")
    print("|---|---|---|---|---|---|")
    for name in ("2", "3", "4", "5", "all"):
        rows = [one for one in found if name in (str(one.vehicles), "all")]
        if rows:
            print(
                f"| {name} | {len(rows)} | {sum(one.tumbles > 0 for one in rows)} "
                f"| {sum(one.least < DISTANCE for one in rows)} | {min(one.least for one in rows):.2f} m "
                f"| {max(one.steepest for one in rows):.0f} deg |"
            )


if __name__ == "__main__":
    main()
