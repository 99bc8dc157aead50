"""How much worse are the localisers of the vehicles than one filter that hears everything at once?

    python docs/examples/central_filter.py               # what localization_measured.md says; half an hour
    python docs/examples/central_filter.py --seeds 2     # fewer runs

Each run is made as it ships. From its log and the draws of its instruments an extended Kalman filter estimates all
vehicles together: position, heading, bias of heading sensor and gyro, and scale error of the DVL of each, with all
correlations (the states of world/navigation/filter.py). It takes each measured range at the tick at which it was
measured, and each fix. No localiser can have that under water, so its error is a lower bound: nobody does better with
the same measurements, but for what the linearisation costs.
"""

from __future__ import annotations

import argparse
from math import cos, hypot, inf, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from fleet.addons.studies.one_run import run_and_record
from fleet.addons.studies.statistics import median
from fleet.logs.open_log import open_log
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from world.navigation.config import DeadReckoning
from world.navigation.instruments import Instruments

METHODS = {
    "navigation-aid": "aid", "locate-naive": "naive", "locate-naive-loop": "naive", "locate-consistent": "consistent",
}  # fmt: skip
AFTER_S = 60.0
GATE = 10.83  # chi-square with 1 degree of freedom, 99.9 %
N, E, PSI, H, G, S = range(6)
SIZE = 6


class Central:
    """The filter of all vehicles; vehicle i has the states 6 i to 6 i + 5."""

    def __init__(self, configs: list[DeadReckoning], places: np.ndarray, headings: list[float]) -> None:
        """Begin. `places`: where the vehicles believe they are, north and east [m], shape (vehicles, 2). `headings`:
        the first sample of each heading sensor [rad]."""
        self._configs = configs
        self.x = np.zeros((len(configs), SIZE))
        self.p = np.zeros((self.x.size, self.x.size))
        self._moved = np.zeros((len(configs), 3))  # since the covariance was brought up to date: north, east, time
        self.nis: list[float] = []  # of the ranges used
        self.x[:, :2], self.x[:, PSI] = places, headings
        for i, config in enumerate(configs):
            grade, own = config.grade, self.p[SIZE * i : SIZE * (i + 1), SIZE * i : SIZE * (i + 1)]
            own[N, N] = own[E, E] = config.start**2
            own[H, H] = grade.heading_bias**2
            own[PSI, PSI] = own[H, H] + grade.heading_noise**2
            own[PSI, H] = own[H, PSI] = -own[H, H]
            own[G, G], own[S, S] = grade.gyro_bias**2, grade.dvl_scale**2

    def move(self, i: int, turn: float, forward: float, starboard: float, dt: float) -> None:
        x = self.x[i]
        turn -= x[G] * dt
        c, s = cos(x[PSI] + 0.5 * turn), sin(x[PSI] + 0.5 * turn)
        forward, starboard = forward / (1.0 + x[S]), starboard / (1.0 + x[S])
        north, east = c * forward - s * starboard, s * forward + c * starboard
        x[N], x[E], x[PSI] = x[N] + north, x[E] + east, x[PSI] + turn
        self._moved[i] += north, east, dt

    def settle(self) -> None:
        """Bring the covariance up to date."""
        f = np.eye(len(self.p))
        for i, (north, east, t) in enumerate(self._moved):
            at, grade, factor = SIZE * i, self._configs[i].grade, 1.0 / (1.0 + self.x[i, S])
            f[at + N, at + PSI], f[at + E, at + PSI], f[at + PSI, at + G] = -east, north, -t
            f[at + N, at + S], f[at + E, at + S] = -north * factor, -east * factor
        self.p = f @ self.p @ f.T
        for i, (_, _, t) in enumerate(self._moved):
            at, grade = SIZE * i, self._configs[i].grade
            for k, rate in ((N, grade.dvl_noise**2 / grade.dvl_rate), (E, grade.dvl_noise**2 / grade.dvl_rate),
                            (PSI, grade.gyro_walk**2), (H, grade.heading_walk**2)):  # fmt: skip
                self.p[at + k, at + k] += rate * t
        self._moved[:] = 0.0

    def use(self, h: np.ndarray, innovation: float, r: float, gate: float = inf) -> float:
        """A scalar measurement with the gradient h, shape (6 vehicles,), and the variance r. Returns NIS."""
        gain = self.p @ h
        s = float(h @ gain) + r
        nis = innovation**2 / s
        if nis <= gate:
            self.x += (gain * (innovation / s)).reshape(self.x.shape)
            self.p -= np.outer(gain, gain) / s
        return nis

    def heading(self, i: int, measured: float) -> None:
        h = np.zeros(len(self.p))
        h[SIZE * i + PSI] = h[SIZE * i + H] = 1.0
        self.use(h, measured - self.x[i, PSI] - self.x[i, H], self._configs[i].grade.heading_noise ** 2)

    def fix(self, i: int, place: tuple[float, float], sigma: float) -> None:
        for axis in (N, E):
            h = np.zeros(len(self.p))
            h[SIZE * i + axis] = 1.0
            self.use(h, place[axis] - self.x[i, axis], sigma * sigma)

    def range(self, i: int, j: int, deeper: float, measured: float, sigma: float) -> None:
        """A range between vehicles i and j, of second order as in agents/localization/range_fusion.py."""
        d = self.x[i, :2] - self.x[j, :2]
        far = hypot(*d, deeper)
        h = np.zeros(len(self.p))
        h[SIZE * i : SIZE * i + 2], h[SIZE * j : SIZE * j + 2] = d / far, -d / far
        at = [SIZE * i, SIZE * i + 1], [SIZE * j, SIZE * j + 1]
        both = sum(self.p[np.ix_(a, a)] for a in at) - self.p[np.ix_(*at)] - self.p[np.ix_(*at)].T
        curved = (np.trace(both) - h @ self.p @ h) / far
        nis = self.use(h, measured - far - 0.5 * curved, sigma * sigma + 0.5 * curved * curved, GATE)
        if nis <= GATE:
            self.nis.append(nis)


class Range(NamedTuple):
    i: int  # of both vehicles, from 0
    j: int
    m: float
    sigma: float


def ranges_of(log: Any, scenario: Scenario) -> dict[int, list[Range]]:
    """All ranges that were measured, by tick."""
    found: dict[int, list[Range]] = {}
    for name in log:
        if name.startswith("link/") and "range" in (packets := log[name]).units:
            src, dst = (int(part) - 1 for part in name.removeprefix("link/").split("-"))
            for k in np.flatnonzero(~np.isnan(packets.range)):
                tick = round(packets.ranged[k] * 1e9 / scenario.tick_ns)
                found.setdefault(tick, []).append(Range(dst, src, packets.range[k], packets.range_sd[k]))
    return found


class Found(NamedTuple):
    """What the filter found, at each second; shapes (seconds, vehicles, 2) and (seconds, vehicles)."""

    off: np.ndarray  # believed minus true position, north and east [m]
    nees: np.ndarray
    nis: list[float]  # of each range used


def central(log: Any, scenario: Scenario) -> Found:
    """What the filter makes of a log."""
    dt, vehicles = scenario.tick_ns / 1e9, range(1, scenario.vehicles + 1)
    configs = [control.navigation for control in scenario.controls]
    tools = [Instruments(config, scenario.seed, i + 1, scenario.tick_ns) for i, config in enumerate(configs)]
    true = np.stack([[log[f"uuv/{i}/state"][name] for name in ("x", "y", "z", "psi")] for i in vehicles])
    true[:, 3] = np.unwrap(true[:, 3])
    begun = np.array([log[f"uuv/{i}/belief"].off[0, :2] for i in vehicles]) + true[:, :2, 0]
    for tool, z in zip(tools, true[:, 2, 0], strict=True):
        tool.turn_rates(0)
        tool.velocity(0, z)
    known = Central(configs, begun, [tool.heading(0, psi) for tool, psi in zip(tools, true[:, 3, 0], strict=True)])
    fixes = {(round(at * 1e9 / scenario.tick_ns), i - 1): k for i in vehicles
             for k, at in enumerate(log[f"uuv/{i}/fix"].measured if f"uuv/{i}/fix" in log else ())}  # fmt: skip
    ranges, off, nees = ranges_of(log, scenario), [], []
    for tick in range(1, true.shape[2]):
        before, after, samples = true[:, :, tick - 1], true[:, :, tick], []
        for i, tool in enumerate(tools):
            turn, psi = after[i, 3] - before[i, 3], 0.5 * (after[i, 3] + before[i, 3])
            moved = tuple(after[i, :3] - before[i, :3])
            known.move(i, turn + tool.gyro[0] * dt, *tool.displacement(moved, (0.0, 0.0, 0.0), psi, dt), dt)
            tool.turn_rates(tick)
            tool.velocity(tick, after[i, 2])
            tool.pressure(tick)
            if (sample := tool.heading(tick, after[i, 3])) is not None:
                samples.append((i, sample))
        at_last = tick * scenario.tick_ns % 1_000_000_000 == 0
        if samples or tick in ranges or at_last:
            known.settle()
        for i, sample in samples:
            known.heading(i, sample)
        for i in range(len(tools)):
            if (k := fixes.get((tick, i))) is not None and (fix := log[f"uuv/{i + 1}/fix"]).used[k]:
                known.settle()
                known.fix(i, (fix.north[k], fix.east[k]), fix.sigma[k])
        for i, j, m, sigma in ranges.get(tick, ()):
            depths = [after[k, 2] + tools[k].depth for k in (i, j)]
            known.range(i, j, depths[0] - depths[1], m, sigma)
        if at_last:
            d = known.x[:, :2] - after[:, :2]
            off.append(d)
            at = [known.p[SIZE * i : SIZE * i + 2, SIZE * i : SIZE * i + 2] for i in range(len(tools))]
            nees.append([d[i] @ np.linalg.solve(p, d[i]) for i, p in enumerate(at)])
    return Found(np.array(off), np.array(nees), known.nis)


def measured(name: str, seed: int) -> dict[str, float]:
    """Root mean square error of vehicles 2 to 4 [m], their mean NEES, and the mean NIS of ranges."""
    localization = f"agent.localization={{method: {METHODS[name]}, nis: true}}"
    scenario = load_scenario(name, [f"seed={seed}", localization, "log={every: 5 ticks, state: 1 tick}"])
    with TemporaryDirectory() as folder:
        run_and_record(scenario, Path(folder) / "run")
        log = open_log(Path(folder) / "run" / "run.mcap")
        off, nees, nis = central(log, scenario)
        late = slice(int(AFTER_S), None), slice(1, None)
        found = {
            "central": rms(off[late]),
            "central NEES": float(nees[late].mean()),
            "central NIS": float(np.mean(nis)),
        }
        own = {kind: [log[f"uuv/{i}/{kind}"] for i in (2, 3, 4)] for kind in ("belief", "located")}
        for kind, topics in own.items():
            found[kind] = rms(np.concatenate([topic.off[topic.t >= AFTER_S, :2] for topic in topics]))
        found["NEES"] = float(np.mean(np.concatenate([topic.nees[topic.t >= AFTER_S] for topic in own["located"]])))
        found["NIS"] = float(np.mean([log[f"uuv/{i}/guidance"].nis[-1] for i in (2, 3, 4)]))
    return found


def rms(off: np.ndarray) -> float:
    """Root mean square of the horizontal error. `off`: shape (..., 2)."""
    return float(np.sqrt(np.mean(np.sum(np.square(off), axis=-1))))


def main(names: list[str], seeds: int) -> None:
    columns = ("belief", "located", "central", "NEES", "NIS", "central NEES", "central NIS")
    print(f"| {seeds} seeds | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1))
    for name in names:
        rows = [measured(name, seed) for seed in range(1, seeds + 1)]
        cells = []
        for column in columns:
            found = median([row[column] for row in rows])
            cells.append(f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})")
        print(f"| `{name}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("names", nargs="*", default=METHODS)
    asked = parser.parse_args()
    main(list(asked.names), asked.seeds)
