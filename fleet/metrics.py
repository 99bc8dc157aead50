"""Numbers that judge a run, streamed from the frames as the log writes them.

| symbol | meaning | unit | source |
|---|---|---|---|
| e_i | consensus error from true positions | m | paper eq. (8) |
| formation error | position minus desired position eta_1^d(t) + p_i | m | docs/paper.md, G12 |
| settle | first time after which a quantity stays below its limit to the end | s | |
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot, isfinite, sqrt
from typing import Any, NamedTuple

from agents.agent import Agent
from fleet.scenario import Scenario
from netem.messages import Command, Frame
from world.vehicle import Vec3

RMS_WINDOW_S = 10.0
SETTLE_M = 0.05
SETTLE_FRACTION = 0.1


class VehicleError(NamedTuple):
    """How far one vehicle is from where it should be, by both measures [m, NED]."""

    e: Vec3
    e_norm: float
    formation: Vec3
    formation_norm: float


@dataclass(slots=True)
class Series:
    """What is kept of one vehicle: one value per frame."""

    e: array[float] = field(default_factory=lambda: array("d"))
    formation: array[float] = field(default_factory=lambda: array("d"))
    effort_Ns: float = 0.0
    u_cmd_max: float = 0.0
    qp_failures: int = 0
    payloads_rejected: int = 0


class Metrics:
    """Streams frames into errors, series and a summary."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        spec = scenario.spec
        self._tick_s = scenario.tick_ns / 1e9
        self._start, self._velocity = spec.reference.start, spec.reference.velocity
        self._neighbours = {
            i: [
                (
                    j,
                    a,
                    tuple(p - q for p, q in zip(scenario.offsets[i - 1], scenario.offsets[j - 1], strict=True)),
                )
                for j, a in scenario.graph.neighbours(i)
            ]
            for i in range(1, scenario.vehicles + 1)
        }
        self._positions_of = _signal_positions()
        self.times = array("d")
        self.series = {i: Series() for i in range(1, scenario.vehicles + 1)}
        self.formation_error = 0.0

    def frame(self, frame: Frame, commands: Mapping[int, Command]) -> dict[int, VehicleError]:
        """Take one frame with its decoded commands; returns the errors of every vehicle in it."""
        t = frame.tick * self._tick_s
        pd1 = tuple(s + v * t for s, v in zip(self._start, self._velocity, strict=True))
        positions = {row.id: row.eta[:3] for row in frame.vehicles}
        errors = {i: self._error(i, positions, pd1) for i in positions}
        elapsed = t - self.times[-1] if self.times else 0.0
        self.times.append(t)
        u_cmd, failures, rejected = self._positions_of
        for row in frame.vehicles:
            series, error = self.series[row.id], errors[row.id]
            series.e.append(error.e_norm)
            series.formation.append(error.formation_norm)
            if row.tau:
                series.effort_Ns += abs(row.tau[0]) * (elapsed or self._tick_s)
            command = commands.get(row.id)
            if command is not None:
                series.u_cmd_max = max(series.u_cmd_max, command.telemetry[u_cmd])
                series.qp_failures = _count(command.telemetry[failures], series.qp_failures)
                series.payloads_rejected = _count(command.telemetry[rejected], series.payloads_rejected)
        self.formation_error = max(error.formation_norm for error in errors.values())
        return errors

    def _error(self, i: int, positions: dict[int, tuple[float, ...]], pd1: tuple[float, ...]) -> VehicleError:
        x, y, z = positions[i]
        px, py, pz = self._scenario.offsets[i - 1]
        fx, fy, fz = x - (pd1[0] + px), y - (pd1[1] + py), z - (pd1[2] + pz)
        b = self._scenario.b[i - 1]
        ex, ey, ez = b * fx, b * fy, b * fz
        for j, a, (dx, dy, dz) in self._neighbours[i]:
            xj, yj, zj = positions[j]
            ex += a * (x - xj - dx)
            ey += a * (y - yj - dy)
            ez += a * (z - zj - dz)
        return VehicleError((ex, ey, ez), hypot(ex, ey, ez), (fx, fy, fz), hypot(fx, fy, fz))

    def worst(self, what: str, after_s: float) -> tuple[float, int, float]:
        """The largest `e` or `formation` of any vehicle from a time on: (value [m], vehicle, time [s]).

        A run that ended before `after_s` gives (inf, 0, end): nothing shows that the limit was kept.
        """
        found = (-1.0, 0, 0.0)
        for i, series in self.series.items():
            for t, value in zip(self.times, getattr(series, what), strict=True):
                if t >= after_s and not value <= found[0]:
                    found = (value, i, t)
        if found[1] == 0:
            return float("inf"), 0, self.times[-1] if self.times else 0.0
        return found

    def summary(self) -> dict[str, Any]:
        """Per vehicle, the numbers of the result table; None where a vehicle never settled."""
        if not self.times:
            return {}
        end = self.times[-1]
        late = [index for index, t in enumerate(self.times) if t >= end - RMS_WINDOW_S]
        rows: dict[str, Any] = {}
        for i, series in self.series.items():
            initial = series.e[0]
            rows[str(i)] = {
                "settle_10pct_s": _settle(self.times, series.e, SETTLE_FRACTION * initial),
                "settle_5cm_s": _settle(self.times, series.e, SETTLE_M),
                "e_rms_m": sqrt(sum(series.e[k] ** 2 for k in late) / len(late)),
                "e_final_m": series.e[-1],
                "formation_final_m": series.formation[-1],
                "effort_Ns": series.effort_Ns,
                "u_cmd_max_mps": series.u_cmd_max,
                "qp_failures": series.qp_failures,
                "payloads_rejected": series.payloads_rejected,
            }
        return rows


def _count(value: float, before: int) -> int:
    # Telemetry is the agent's word; a stranger's agent may say anything that is a double.
    return int(value) if isfinite(value) else before


def _settle(times: array[float], values: array[float], limit: float) -> float | None:
    settled = None
    for t, value in zip(times, values, strict=True):
        if not (isfinite(value) and value < limit):
            settled = None
        elif settled is None:
            settled = t
    return settled


def _signal_positions() -> tuple[int, int, int]:
    positions, at = {}, 0
    for signal in Agent.signals:
        positions[signal.name] = at
        at += signal.width
    return positions["u_cmd"], positions["qp_failures"], positions["payloads_rejected"]
