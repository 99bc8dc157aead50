"""A check in Python while it is judged: behind a fence, so that whatever it does becomes its verdict."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from math import isnan
from typing import Any, NamedTuple

from fleet.checks.api import Facts, Failure, Fault, Margin, NotJudged, Packet, Tick, Vehicle
from fleet.checks.values import TickValues
from fleet.errors import FleetError
from fleet.quantities import vehicle_names
from fleet.result.verdict import Moment, Verdict, who
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import SOMETIMES
from fleet.scenario.sections.python_checks import load_check, parameters_of
from fleet.scenario.sections.signals import SignalPlace
from netem.parsing import nearest
from netem.wire.messages import Fate
from world.errors import PluginError
from world.plugins.fence import Fence, show_value

BUDGET_S = 5.0  # wall time that one call may take
PATIENCE = 12  # times that, if it hardly computes: a suspended process or a busy machine breaks no check
_MOST_TEXT = 300  # characters of a message, or of a text about what was found
_MOST_PARAMETER = 50  # characters of one in the words of its check
_MOST_VALUES = 100  # values and vehicles of one failure


class CheckError(FleetError):
    """A check in Python cannot be made, or cannot go on; `where` is the file and line at fault, or ""."""

    def __init__(self, check: str, problem: str, where: str = "") -> None:
        super().__init__(f"check {check}: {problem}" + (f" ({where})" if where else ""))
        self.check = check
        self.problem = problem
        self.where = where


class _NoSignal(NamedTuple):
    """Why there is no such signal. A check may ask at every tick, so the words are made when somebody reads them."""

    vehicle: str  # `vehicle 3`, or the name of a node
    signal: Any
    there: Collection[str]

    def __str__(self) -> str:
        hint = nearest(str(self.signal), self.there) or f"it has {', '.join(self.there)}"
        return f"{self.vehicle} has no signal {self.signal!r}; {hint}"


class SeenVehicle:
    """One vehicle at one tick, as a check sees it."""

    __slots__ = ("_asked", "_names", "_places", "_values", "alive", "id")

    def __init__(
        self,
        number: int,
        alive: bool,
        values: TickValues,
        places: Mapping[str, SignalPlace],
        asked: dict[str, None],
        names: Sequence[str] = (),
    ) -> None:
        """Show a vehicle; `asked` is filled with the names of the signals that are looked at, and `names` are those of
        nodes, if there are some.
        """
        self.id, self.alive, self._names = number, alive, names
        self._values, self._places, self._asked = values, places, asked

    def __getitem__(self, signal: str) -> Any:
        """The value of a signal; None if the vehicle did not report it at this tick. Raises LookupError if there is no
        such signal.
        """
        place = self._places.get(signal)
        if place is None:
            raise LookupError(_NoSignal(vehicle_names([self.id], self._names), signal, self._places))
        self._asked[signal] = None
        found = self._values.values(self.id, signal.partition(".")[0])[place.values]
        if not found or (place.width == 1 and isnan(found[0])):
            return None
        return found[0] if place.width == 1 else found


class RunningPythonCheck:
    """A check in Python, and how it came out so far."""

    def __init__(
        self, name: str, class_name: str, given: Mapping[str, Any], facts: Facts, budget_s: float | None = None
    ) -> None:
        """`class_name` is `package.module:Class`, `given` what the scenario has of it. Raises CheckError if it cannot
        be made.
        """
        self.name = name
        self.looked_at: dict[str, None] = {}  # signals
        parameters = parameters_of(given)
        self._facts = facts
        # What it prints goes to standard error; there is no place for notes beside a verdict.
        self._fence = Fence(
            class_name, BUDGET_S if budget_s is None else budget_s, [], partial(_error, class_name), PATIENCE
        )
        try:
            found = load_check(class_name, parameters)
        except PluginError as error:
            raise CheckError(class_name, error.problem, error.hint) from None
        self._check = self._fence.make(found, facts, parameters)
        about = next(iter((found.__doc__ or class_name).strip().splitlines()), class_name).rstrip(".")
        self.words = ", ".join([about, *(f"{key} {_short(value)}" for key, value in parameters.items())])
        self._failure: Failure | None = None
        self._sometimes = SOMETIMES in given  # what fails it is what some run must reach
        if self._sometimes:
            self.words = f"sometimes broken: {self.words}"
        self._at_s = 0.0
        self._broken = False

    def step(
        self, tick: int, t: float, vehicles: Sequence[Vehicle], faults: Sequence[Fault], packets: Sequence[Packet]
    ) -> Failure | None:
        """Show it a tick; returns how the property is broken, if it is, the first time."""
        if self._failure is not None:
            return None
        self._at_s = t
        method = getattr(self._check, "step", None)
        seen = Tick(tick, t, tuple(vehicles), tuple(faults), tuple(packets))
        try:
            self._failure = self._checked(tick, method, self._fence.call(tick, method, seen))  # type: ignore[arg-type]
        except CheckError as error:
            self._break(error)
        return self._failure

    def verdict(self, moment: Moment | None, now: int, *, over: bool) -> Verdict:
        """The verdict so far, at tick `now`; `moment` is that of the failure. `over`: the run has come to its end."""
        verdict = self._judged(moment, now, over=over)
        if self._sometimes and not self._broken:
            return verdict.of_sometimes(verdict.failed and (over or self._failure is not None))
        if self._broken or not callable(method := getattr(self._check, "margin", None)):
            return verdict
        try:
            margin = self._margin(now, method, self._fence.call(now, method))
        except CheckError as error:
            if not over:
                return self._verdict(None, self._words(_broken(error)), None)
            self._break(error)
            return self._judged(moment, now, over=over)
        return verdict if margin is None else verdict.with_margin(margin.value, margin.unit, margin.at_s)

    def _judged(self, moment: Moment | None, now: int, *, over: bool) -> Verdict:
        found, value = "as asked", 1.0  # a check that failed did so once
        method = getattr(self._check, "verdict", None)
        if self._failure is None and callable(method):
            try:
                answer = self._fence.call(now, method)
                if isinstance(answer, NotJudged) and isinstance(answer.message, str):
                    return self._verdict(None, " ".join(answer.message.split())[:_MOST_TEXT], None)
                if isinstance(answer, str):
                    found = " ".join(answer.split())[:_MOST_TEXT] or found
                elif (at_end := self._checked(now, method, answer)) is not None:
                    # What only the end can show is not failed while the run goes on.
                    return self._verdict(False if over else None, self._words(at_end), value if over else None)
            except CheckError as error:
                if not over:  # the check may have too little to go by, and asking now must change nothing
                    return self._verdict(None, _broken(error).message, None)
                self._break(error)
        if self._failure is None:
            return self._verdict(True, found, 0.0)
        found = f"{self._words(self._failure)} at {self._at_s:g} s"
        return self._verdict(False, found, None if self._broken else value, moment)

    def _verdict(self, passed: bool | None, found: str, value: float | None, moment: Moment | None = None) -> Verdict:
        return Verdict(
            self.name,
            bool(passed),
            self.words,
            found,
            value,
            0.0,
            "times",
            moment,
            tuple(self.looked_at)[:_MOST_VALUES],
            judged=passed is not None,
        )

    def _words(self, failure: Failure) -> str:
        values = ", ".join(f"{name} {value:.4g}" for name, value in list(failure.values.items())[:4])
        return f"{failure.message}{who(failure.vehicles, self._facts.names)}{f', {values}' if values else ''}"

    def _break(self, error: CheckError) -> None:
        self._broken, self._failure = True, _broken(error)

    def _margin(self, tick: int, method: Any, answer: Any) -> Margin | None:
        if answer is None:
            return None
        try:
            value, unit, at = float(answer.value), str(answer.unit)[:_MOST_PARAMETER], answer.at_s
            return Margin(value, unit, None if at is None else float(at))
        except Exception:  # whatever the user's objects raise when they are asked
            expected = "None or a fleet.checks.api.Margin"
            raise self._fence.wrong(tick, method, f"returned {show_value(answer)}: expected {expected}") from None

    def _checked(self, tick: int, method: Any, answer: Any) -> Failure | None:
        if answer is None:
            return None
        if not isinstance(answer, Failure):
            expected = "None or a fleet.checks.api.Failure"
            raise self._fence.wrong(tick, method, f"returned {show_value(answer)}: expected {expected}")
        message, vehicles, values = answer
        if not isinstance(message, str):
            raise self._fence.wrong(
                tick, method, f"returned a Failure with message {show_value(message)}: expected a text"
            )
        try:
            numbers = tuple(int(i) for i in vehicles)[:_MOST_VALUES]
            found = {str(name): float(value) for name, value in list(values.items())[:_MOST_VALUES]}
        except Exception:  # whatever the user's objects raise when they are asked
            text = f"returned a Failure with vehicles {show_value(vehicles)} and values {show_value(values)}"
            raise self._fence.wrong(tick, method, f"{text}: expected numbers, and numbers by name") from None
        if strangers := [i for i in numbers if not 1 <= i <= self._facts.vehicles]:
            raise self._fence.wrong(tick, method, f"returned a Failure of vehicle {strangers[0]}: there is none")
        return Failure(" ".join(message.split())[:_MOST_TEXT] or "broken", numbers, found)


def _broken(error: CheckError) -> Failure:
    where = f" ({error.where})" if error.where else ""
    return Failure(f"the check is broken, so nothing is known: {error.problem}{where}")


def _short(parameter: Any) -> str:
    text = show_value(parameter).strip("'")
    return text if len(text) <= _MOST_PARAMETER else f"{text[:_MOST_PARAMETER]}..."


def _error(class_name: str, tick: int, problem: str, where: str) -> CheckError:
    return CheckError(class_name, problem, where)


def facts_of(scenario: Scenario, begin: int, places: Mapping[int, Mapping[str, SignalPlace]]) -> Facts:
    """The facts that checks get about a scenario whose run begins at a tick."""
    return Facts(
        scenario=scenario.name,
        seed=scenario.seed,
        vehicles=scenario.vehicles,
        duration=scenario.duration_ns / 1e9,
        tick=scenario.tick_ns / 1e9,
        begin=begin * scenario.tick_ns / 1e9,
        links=tuple(scenario.graph.links),
        units={i: {name: place.unit for name, place in signals.items()} for i, signals in places.items()},
        names=scenario.names,
    )


def packets_of(fates: Iterable[Fate], tick_s: float) -> list[Packet]:
    """Fates as checks see them."""
    return [
        Packet(f.src, f.dst, f.sent_tick * tick_s, f.final_tick * tick_s, str(f.cause), f.corrupted, f.payload)
        for f in fates
    ]
