"""Measures by signal: `p95 |error.e|` is a number of every run, computed from the samples that its log would have.

A signal is named as in `fleet.scenario.sections.signals`, `error.e_norm` for that of all vehicles; here it may also
be that of one, `uuv/3/error.e_norm`.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import CHECK, MORE_IS_BETTER, SEPARATION, STANDING, MeasureColumn, is_of_check
from fleet.checks.values import values_of
from fleet.logs.open_log import Log
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.recorder.metrics import VehicleError
from fleet.recorder.separation import Separation
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signal_checks import checked_signals
from fleet.scenario.sections.signals import (
    SIGNAL,
    SignalError,
    SignalName,
    SignalPlace,
    VehicleSignals,
    read_name,
    unit_of,
)
from netem.parsing import nearest
from netem.wire.messages import Command, Frame

MOST_UNASKED = 4  # measures that are made because checks name their signals
_EXAMPLE = '"p95 |error.e|", "max |control.u_err|", "final uuv/3/state.z" or "mean error.e_norm after 20 s"'
_GRAMMAR = re.compile(rf"(?P<how>\w[\w.]*)\s+{SIGNAL}(?:\s+after\s+(?P<after>\S.*))?", re.ASCII)
LONGEST_TEXT = 200  # characters; patterns with several runs of spaces take a time that grows with the square of it
_PERCENTILE = re.compile(r"p(\d{1,2}(?:\.\d{1,3})?|100)", re.ASCII)
_HOW: dict[str, Callable[[NDArray[np.float64]], float]] = {
    "min": lambda values: float(values.min()),
    "mean": lambda values: float(values.mean()),
    "max": lambda values: float(values.max()),
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "final": lambda values: float(values[-1]),
}


@dataclass(frozen=True, slots=True)
class SignalMeasure:
    """One number of a signal."""

    how: str  # `min`, `mean`, `max`, `rms`, `final`, or a percentile such as `p95`
    signal: SignalName  # of every vehicle: of each that reports it, and then the largest, with `min` the least
    after_ns: int = 0  # samples before that do not count [ns]

    def __str__(self) -> str:
        after = f" after {show_time(self.after_ns)}" if self.after_ns else ""
        return f"{self.how} {self.signal}{after}"

    def of(self, values: NDArray[np.float64]) -> float:
        """The number of these samples of one vehicle, at least one."""
        if percentile := _PERCENTILE.fullmatch(self.how):
            return float(np.percentile(values, float(percentile[1])))
        return _HOW[self.how](values)


def is_signal(name: str) -> bool:
    return " " in name.strip() and not is_of_check(name)


def parse_signal(text: str) -> SignalMeasure:
    """A measure as the user writes it. Raises StudyError: it is none."""
    found = _GRAMMAR.fullmatch(text.strip()) if len(text) <= LONGEST_TEXT else None
    if found is None:
        raise StudyError(f'"{text[:60]}" is no measure of a signal: expected one such as {_EXAMPLE}')
    how, after = found["how"], found["after"]
    if how not in _HOW and not _PERCENTILE.fullmatch(how):
        raise StudyError(f'"{text[:60]}": expected {", ".join(_HOW)} or a percentile such as p95, got "{how[:20]}"')
    try:
        after_ns = time_ns(after) if after else 0
    except QuantityError as error:
        raise StudyError(f'"{text[:60]}": {error}') from None
    return SignalMeasure(how, read_name(found), max(0, after_ns))


def signal_columns_of(texts: Iterable[str], scenarios: Sequence[Scenario]) -> list[MeasureColumn]:
    """The column of each measure of a signal: its name and unit. `scenarios`: of all points. A signal has to be one of
    some vehicle in one of them; elsewhere it is missing. Raises StudyError: a text is no measure, or there is no such
    signal."""
    measures = [parse_signal(text) for text in dict.fromkeys(texts)]
    if not measures:
        return []
    fleets = {
        (scenario.vehicles, tuple(scenario.layout(i) for i in range(1, scenario.vehicles + 1))): scenario
        for scenario in scenarios
    }
    return [_column(measure, list(fleets.values())) for measure in dict.fromkeys(measures)]


def measures_of_checks(scenarios: Sequence[Scenario]) -> tuple[str, ...]:
    """A measure for each signal that a check of the scenarios names: how near the check it came. That is the largest
    value where the check asks for a small one, the least where it asks for a large one, and else the last one."""
    found: dict[str, None] = {}
    for scenario in scenarios:
        named = {str(name) for name in checked_signals(scenario.spec.checks)}
        for check in scenario.spec.checks.signal or ():
            if check.topic in named:
                how = "max" if check.below is not None else "min" if check.above is not None else "final"
                found[str(parse_signal(f"{how} {check.topic}"))] = None
    return tuple(found)[:MOST_UNASKED]


def more_is_better(name: str) -> bool:
    """Whether a larger number is the better one; of signals only if it is the least value, as of a distance."""
    if is_signal(name):
        return parse_signal(name).how == "min"
    return name in MORE_IS_BETTER or name.startswith((CHECK, "margin."))


def check_name(name: str) -> None:
    """Raises StudyError: no study can have a measure of this name."""
    if is_signal(name):
        parse_signal(name)
    elif not is_of_check(name):  # the scenario says which checks there are
        find_columns([name])


def find_columns(names: Iterable[str], columns: Iterable[MeasureColumn] = STANDING) -> list[MeasureColumn]:
    """The columns of the measures of these names. `names`: also of measures of signals. `columns`: the existing ones.
    Raises StudyError: there is none of a name."""
    known = {column.name: column for column in columns}
    found = []
    for name in names:
        wanted = str(parse_signal(name)) if is_signal(name) else name
        if wanted not in known:
            hint = nearest(wanted, known) or f"there are {', '.join(known)}"
            if is_signal(name):
                hint = "a measure of a signal is named when the study is made"
            raise StudyError(f'there is no measure "{name[:60]}"; {hint}')
        found.append(known[wanted])
    return found


def _column(measure: SignalMeasure, scenarios: Sequence[Scenario]) -> MeasureColumn:
    most = max(scenario.vehicles for scenario in scenarios)
    if measure.signal.vehicle is not None and measure.signal.vehicle > most:
        raise StudyError(f'"{measure}": there is no vehicle {measure.signal.vehicle}: the vehicles are 1 to {most}')
    each = ((scenario, i) for scenario in scenarios for i in _vehicles(measure, scenario))
    some = (_places(scenario, i) for scenario, i in each)
    try:
        unit = unit_of(measure.signal, some)
    except SignalError as error:
        raise StudyError(f'"{measure}": {error}') from None
    return MeasureColumn(str(measure), "" if unit == "1" else unit)


def _places(scenario: Scenario, i: int) -> dict[str, SignalPlace]:
    clock, belief = i in scenario.clocks, scenario.belief(i)
    return VehicleSignals(scenario.layout(i), scenario.plant_signals(i), clock, belief).places()


def _vehicles(measure: SignalMeasure, scenario: Scenario) -> range:
    if measure.signal.vehicle is None:
        return range(1, scenario.vehicles + 1)
    return range(measure.signal.vehicle, min(measure.signal.vehicle, scenario.vehicles) + 1)


class _Kept(NamedTuple):
    measure: SignalMeasure
    group: str
    values: slice
    every: int  # ticks between two samples
    first: int  # tick
    samples: array[float]


class Samples:
    """Watches one run for measures of signals, and for the least distance of its vehicles.

    It samples a signal at the same ticks as the log. All samples are kept until the end, 8 bytes each.
    """

    def __init__(self, scenario: Scenario, names: Iterable[str] = ()) -> None:
        """`names`: of the measures."""
        self._last = scenario.ticks
        self._names = {name: parse_signal(name) for name in names}
        self._separation = Separation(range(1, scenario.vehicles + 1))
        self._kept: dict[int, list[_Kept]] = {}
        for measure in self._names.values():
            for i in _vehicles(measure, scenario):
                if (place := _places(scenario, i).get(measure.signal.name)) is not None:
                    group = measure.signal.group
                    first = -(-measure.after_ns // scenario.tick_ns)
                    kept = _Kept(measure, group, place.values, scenario.log_every[group], first, array("d"))
                    self._kept.setdefault(i, []).append(kept)

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        self._separation.frame(frame)
        if not self._kept:
            return
        tick = frame.tick
        for row in frame.vehicles:
            for measure, group, place, every, first, samples in self._kept.get(row.id, ()):
                if tick < first or (tick % every and tick != self._last):
                    continue
                values = values_of(group, row, commands.get(row.id), errors[row.id])[place]
                if values:
                    samples.append(measure.signal.value(values))

    def read(self, log: Log) -> None:
        """Take the samples of a log, in place of frames; every signal of it has to be one number."""
        for i, rows in self._kept.items():
            for measure, group, _, _, _, samples in rows:
                if (found := f"uuv/{i}/{group}") not in log:
                    continue
                topic, name = log[found], measure.signal.name.partition(".")[2]
                for at_s, value in zip(topic.t.tolist(), topic[name].tolist(), strict=True):
                    if at_s * 1e9 >= measure.after_ns:
                        samples.append(measure.signal.value((value,)))

    def numbers(self) -> dict[str, float]:
        """Every measure by name; NaN where no vehicle reported it."""
        found = {name: self._number(measure) for name, measure in self._names.items()}
        least = self._separation.least
        return found | {SEPARATION.name: nan if least is None else least.distance_m}

    def _number(self, measure: SignalMeasure) -> float:
        """A value that the agents did not report, because they were dead or had none, is NaN, and left out."""
        every = [np.array(kept.samples) for rows in self._kept.values() for kept in rows if kept.measure == measure]
        there = [values[~np.isnan(values)] for values in every]
        join = min if measure.how == "min" else max
        return join((measure.of(values) for values in there if len(values)), default=nan)
