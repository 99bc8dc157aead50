"""Numbers that judge a run, streamed from the frames as the log writes them.

| symbol | meaning | unit | source |
|---|---|---|---|
| e_i | consensus error from true positions | m | paper eq. (8) |
| formation error | position minus desired position eta_1^d(t) + p_i | m | docs/background/paper.md, G12 |
| settle | first time after which a quantity stays below its limit to the end, for long enough | s | `settling` |
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot, inf, isfinite, sqrt
from statistics import median
from typing import NamedTuple

from agents.offset import Offset
from agents.signals import SignalLayout
from fleet.recorder.settling import first_settled, is_long_enough, least_s, settling_time
from fleet.result.result import Formation, SignalValue, VehicleResult
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.sections.signal_checks import checked_signals
from netem.wire.messages import Command, Frame
from world.vectors import Vec3, plus

RMS_WINDOW_S = 10.0
SETTLE_M = 0.05
SETTLE_FRACTION = 0.1


class Settled(NamedTuple):
    """When an error settled within a span of time, and what is reported if it did not."""

    at_s: float | None  # None: it did not, or too late to be judged
    vehicle: int  # the last to settle, else the farthest off that did not; 0: the span has no frame
    off_m: float  # that vehicle's error in the last frame of the span
    least_s: float  # how long it had to stay


class VehicleError(NamedTuple):
    """How far one vehicle is from where it should be, by both measures [m, NED]."""

    e: Vec3
    e_norm: float
    formation: Vec3
    formation_norm: float


@dataclass(slots=True)
class Series:
    """The record of one vehicle: one value per frame, and sums over them."""

    e: array[float] = field(default_factory=lambda: array("d"))
    formation: array[float] = field(default_factory=lambda: array("d"))
    effort_Ns: float = 0.0
    u_cmd_max: float | None = None  # None: its controller reports no commanded speed
    qp_failures: int = 0
    qp_counted: int = 0  # by the agent that runs now
    payloads_rejected: int = 0
    reported: tuple[float, ...] = ()  # what the agent told last
    reported_tick: int | None = None  # when


class _Places(NamedTuple):
    """Where an agent's telemetry has what the summary wants; None where it does not report it."""

    u_cmd: int | None
    failures: int | None
    rejected: int | None

    @classmethod
    def of(cls, layout: SignalLayout) -> _Places:
        places = [layout.where(name) for name in ("u_cmd", "qp_failures", "payloads_rejected")]
        return cls(*(None if place is None else place.start for place in places))


class _Vehicle(NamedTuple):
    plan: Offset  # p_i
    b: float
    neighbours: tuple[tuple[int, float], ...]  # j and a_ij
    places: _Places
    series: Series


class Metrics:
    """Streams frames into errors, series and a summary."""

    def __init__(self, scenario: Scenario) -> None:
        self._reference = scenario.reference
        self._tick_s = scenario.tick_ns / 1e9
        self._disturbance = scenario.disturbance
        self._protocols = {i: AgentProtocol.of(scenario, i) for i in range(1, scenario.vehicles + 1)}
        # Who reported before the last round and the last frames reports no more.
        self._silent_ticks = max(scenario.round_ticks, frame_every(scenario))
        self._tick = 0  # tick of the last frame
        self.times = array("d")
        self.series = {i: Series() for i in range(1, scenario.vehicles + 1)}
        self._vehicles = {
            i: _Vehicle(
                scenario.plans[i - 1],
                scenario.b[i - 1],
                scenario.graph.neighbours(i),
                _Places.of(scenario.layout(i)),
                series,
            )
            for i, series in self.series.items()
        }

    def frame(self, frame: Frame, commands: Mapping[int, Command]) -> dict[int, VehicleError]:
        """Take one frame with its decoded commands; returns the errors of every vehicle in it."""
        t = frame.tick * self._tick_s
        reference = self._reference.at(t).position
        vehicles = self._vehicles
        # Where each vehicle is and where it should be [m, NED].
        spots: dict[int, tuple[tuple[float, ...], Vec3]] = {}
        for row in frame.vehicles:
            plan = vehicles[row.id].plan
            spots[row.id] = row.eta, plus(reference, plan.at(t).position if plan.changes else plan.start)
        elapsed = (t - self.times[-1] if self.times else 0.0) or self._tick_s
        self.times.append(t)
        self._tick = frame.tick
        errors = {}
        for row in frame.vehicles:
            i, tau = row.id, row.tau
            vehicle = vehicles[i]
            series = vehicle.series
            errors[i] = error = _error(i, vehicle, spots)
            series.e.append(error.e_norm)
            series.formation.append(error.formation_norm)
            if tau:
                series.effort_Ns += abs(tau[0]) * elapsed
            if i in commands and (telemetry := commands[i].telemetry):
                _take(series, vehicle.places, telemetry)
                series.reported, series.reported_tick = telemetry, frame.tick
        return errors

    @property
    def formation(self) -> Formation:
        off = {i: series.formation[-1] for i, series in self.series.items() if series.formation}
        if not off:
            return Formation()
        worst = max(off, key=off.__getitem__)
        return Formation(off[worst], worst, median(off.values()), len(off))

    def worst(
        self, what: str, after_s: float, vehicles: list[int] | None = None, before_s: float = inf
    ) -> tuple[float, int, float]:
        """The largest `e` or `formation` of any vehicle, or of some, from a time on: (value [m], vehicle, time [s]).

        A run that ended before `after_s` gives (inf, 0, end): nothing shows that the limit was kept.
        """
        found = (-1.0, 0, 0.0)
        for i, series in self.series.items():
            if vehicles is not None and i not in vehicles:
                continue
            for t, value in zip(self.times, getattr(series, what), strict=True):
                if after_s <= t < before_s and not value <= found[0]:
                    found = (value, i, t)
        if found[1] == 0:
            return float("inf"), 0, self.times[-1] if self.times else 0.0
        return found

    def first_over(
        self, what: str, limit: float, after_s: float, vehicles: list[int] | None = None
    ) -> tuple[float, int] | None:
        """When `e` or `formation` of a vehicle was not below a limit [m] for the first time from a time on, and whose:
        (time [s], vehicle); None: never.
        """
        for k in range(bisect_left(self.times, after_s), len(self.times)):
            for i, series in self.series.items():
                if (vehicles is None or i in vehicles) and not getattr(series, what)[k] < limit:
                    return self.times[k], i
        return None

    def median_worst(self, what: str, after_s: float, vehicles: list[int] | None = None) -> float:
        """The median over vehicles, all or some, of the largest `e` or `formation` of each from a time on [m]."""
        begin = bisect_left(self.times, after_s)
        chosen = [series for i, series in self.series.items() if vehicles is None or i in vehicles]
        return median(max(getattr(series, what)[begin:], default=inf) for series in chosen)

    def qp_failures(self) -> dict[int, int]:
        """How often the gain's optimisation failed, of each vehicle whose law counts that."""
        return {i: s.qp_failures for i, s in self.series.items() if self._vehicles[i].places.failures is not None}

    def find_settled(
        self, what: str, span: tuple[int, int], limit: float, vehicles: list[int] | None = None
    ) -> Settled:
        """When `e` or `formation` of every vehicle, or of some, settled below a limit [m] in a span: first tick, behind
        the last.
        """
        frames = range(bisect_left(self.times, span[0] * self._tick_s), bisect_left(self.times, span[1] * self._tick_s))
        if not frames:
            return Settled(None, 0, 0.0, 0.0)
        last, slowest = -1, 0  # frame from which all so far are below, and whose it is
        farthest = -1.0, 0
        for i, series in self.series.items():
            if vehicles is not None and i not in vehicles:
                continue
            values = getattr(series, what)
            first = first_settled(values, limit, frames.start, frames.stop)
            if first > last:
                last, slowest = first, i
            if not values[frames[-1]] <= farthest[0]:
                farthest = values[frames[-1]], i
        least = least_s(self._disturbance, self.times[frames[-1]] - span[0] * self._tick_s)
        if last == frames.stop:
            return Settled(None, farthest[1], farthest[0], least)
        at_s = self.times[last] if is_long_enough(self.times, last, frames.stop, least) else None
        return Settled(at_s, slowest, getattr(self.series[slowest], what)[frames[-1]], least)

    def _is_silent(self, series: Series) -> bool:
        """Whether an agent ended before the run. Compared in ticks: of times in seconds the last bits decided."""
        return series.reported_tick is None or self._tick - series.reported_tick > self._silent_ticks

    def summary(self) -> dict[str, VehicleResult]:
        """Per vehicle, the numbers of the result table; None where a vehicle has not settled."""
        if not self.times:
            return {}
        end = self.times[-1]
        late = [index for index, t in enumerate(self.times) if t >= end - RMS_WINDOW_S]
        rows: dict[str, VehicleResult] = {}
        for i, series in self.series.items():
            initial = series.e[0]
            protocol = self._protocols[i]
            rows[str(i)] = VehicleResult(
                settle_10pct_s=settling_time(self.times, series.e, SETTLE_FRACTION * initial, self._disturbance),
                settle_5cm_s=settling_time(self.times, series.e, SETTLE_M, self._disturbance),
                e_rms_m=sqrt(sum(series.e[k] * series.e[k] for k in late) / len(late)),
                e_final_m=series.e[-1],
                formation_final_m=series.formation[-1],
                effort_Ns=series.effort_Ns,
                u_cmd_max_mps=series.u_cmd_max,
                qp_failures=series.qp_failures,
                payloads_rejected=series.payloads_rejected,
                agent=protocol.law,
                signals=protocol.values(() if self._is_silent(series) else series.reported),
            )
        return rows


def _error(i: int, vehicle: _Vehicle, spots: Mapping[int, tuple[tuple[float, ...], Vec3]]) -> VehicleError:
    """e_i = sum_j a_ij ((x_i - d_i) - (x_j - d_j)) + b_i (x_i - d_i): Delta_ij is d_i - d_j."""
    (x, y, z, _, _), (dx, dy, dz) = spots[i]
    fx, fy, fz = x - dx, y - dy, z - dz
    b = vehicle.b
    ex, ey, ez = b * fx, b * fy, b * fz
    for j, a in vehicle.neighbours:
        (xj, yj, zj, _, _), (px, py, pz) = spots[j]
        ex += a * (x - xj - (dx - px))
        ey += a * (y - yj - (dy - py))
        ez += a * (z - zj - (dz - pz))
    return VehicleError((ex, ey, ez), hypot(ex, ey, ez), (fx, fy, fz), hypot(fx, fy, fz))


def _take(series: Series, places: _Places, telemetry: tuple[float, ...]) -> None:
    if places.u_cmd is not None:
        speed = telemetry[places.u_cmd]
        if isfinite(speed) and (series.u_cmd_max is None or speed > series.u_cmd_max):
            series.u_cmd_max = max(0.0, speed)
    # The counts hardly ever change.
    if places.failures is not None and telemetry[places.failures] != series.qp_counted:
        count = _count(telemetry[places.failures], series.qp_counted)
        # An agent counts from its own start: what came before a restart stays counted.
        series.qp_failures += count if count < series.qp_counted else count - series.qp_counted
        series.qp_counted = count
    if places.rejected is not None and telemetry[places.rejected] != series.payloads_rejected:
        series.payloads_rejected = _count(telemetry[places.rejected], series.payloads_rejected)


def _count(value: float, before: int) -> int:
    # Telemetry comes from the agent; an external agent may send any double.
    return int(value) if isfinite(value) else before


class _Reported(NamedTuple):
    name: str
    unit: str
    place: int  # in the telemetry


class AgentProtocol(NamedTuple):
    """The whole agent of one vehicle, and what it reports; without a name it has the laws of a controller instead."""

    law: str
    signals: tuple[_Reported, ...]  # signals that a check of the scenario names come first

    @classmethod
    def of(cls, scenario: Scenario, vehicle: int) -> AgentProtocol:
        agent = scenario.agent_config(vehicle).agent
        if agent is None:
            return cls("", ())
        judged = {signal.name for signal in checked_signals(scenario.spec.checks)}
        known = [
            (f"{group}.{signal.name}", _Reported(signal.name, signal.unit, place.start))
            for group, signal, place in scenario.layout(vehicle).signals()
            if signal.width == 1
        ]
        named = [signal for name, signal in known if name in judged]
        others = [signal for name, signal in known if name not in judged]
        return cls(agent.name, (*named, *others))

    def values(self, telemetry: tuple[float, ...]) -> dict[str, SignalValue]:
        """The last report of the vehicle, by name; empty: it reports no more."""
        return {
            name: SignalValue(telemetry[place] if isfinite(telemetry[place]) else None, unit)
            for name, unit, place in (self.signals if telemetry else ())
        }
