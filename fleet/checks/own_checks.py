"""The checks of one run that are the user's own: fed in the order of the log, judged at any time.

A tick is judged when everything of it is known: when something later comes, or a verdict is asked for. So the report
can name a message that arrives at the very tick of the failure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from math import isfinite, isnan
from typing import Any, NamedTuple

from msgspec.structs import replace

from agents.message import VERSION
from fleet.checks.api import Facts, Failure, Fault, Margin, NotJudged, Packet, Tick, Vehicle
from fleet.checks.signal_check import RunningSignalCheck
from fleet.checks.values import Error, FrameValues, TickValues
from fleet.errors import FleetError
from fleet.logs.payload_kinds import STATE, kind_of
from fleet.quantities import QuantityError, vehicle_numbers
from fleet.result.verdict import LastMessage, Moment, Verdict, who
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import SOMETIMES
from fleet.scenario.sections.python_checks import load_check, parameters_of
from fleet.scenario.sections.signal_checks import ask
from fleet.scenario.sections.signals import GROUPS, SignalPlace, VehicleSignals
from fleet.scenario.sections.timeline import Event
from fleet.scenario.sections.vehicle_events import DIVERGED
from netem.condition import Link
from netem.fault_kinds import Cause
from netem.parsing import nearest
from netem.wire.messages import Command, Fate, Frame
from world.errors import PluginError
from world.plugins.fence import Fence, shown

# --- last messages: the last packets of every link, to tell which message made the difference to a vehicle
# Only messages of the protocol that a check judges count. Which these are is told by the signals that the check looks
# at:
#
# | signals | messages |
# |---|---|
# | `control` | those of the agent's own protocol (all kinds but state messages); if it sends none, state messages |
# | `guidance`, `error` | state messages, by which the formation is kept |
# | all others | none: a depth or a force is not judged by what was heard |


_OF_A_PROTOCOL = bytes((VERSION,))  # begins every message that `agents.api.pack` makes


class LastMessages:
    """For each link and protocol: the last fate, and the sending time of the newest message that arrived whole."""

    def __init__(self, links: Sequence[Link], tick_ns: int) -> None:
        self._states, self._own = _LastOfLinks(links, tick_ns / 1e9), _LastOfLinks(links, tick_ns / 1e9)

    def settle(self, fate: Fate) -> None:
        own = fate.payload[:1] == _OF_A_PROTOCOL or kind_of(fate.payload) != STATE
        (self._own if own else self._states).settle(fate)

    def of(self, vehicles: Collection[int], signals: Iterable[str]) -> LastMessage | None:
        """The message that made the difference to the vehicles that failed a check, of the signals that it looks at: of
        the links whose last packet was lost, that of the link with the longest time since an arrival, else the packet
        that arrived last. None if the check judges no protocol, or no packet of it has had a fate yet.
        """
        groups = {signal.lstrip("| ").partition(".")[0] for signal in signals}
        if "control" in groups:
            return (self._own if self._own.any else self._states).of(vehicles)
        return self._states.of(vehicles) if groups & {"guidance", "error"} else None


class _LastOfLinks:
    def __init__(self, links: Sequence[Link], tick_s: float) -> None:
        self._tick_s = tick_s
        self._into: dict[int, list[int]] = {}
        for src, dst in links:
            self._into.setdefault(dst, []).append(src)
        self._last: dict[Link, Fate] = {}
        self._heard: dict[Link, int] = {}  # tick of sending

    @property
    def any(self) -> bool:
        return bool(self._last)

    def settle(self, fate: Fate) -> None:
        link = fate.src, fate.dst
        self._last[link] = fate
        if fate.cause == Cause.DELIVERED and not fate.corrupted:
            self._heard[link] = max(fate.sent_tick, self._heard.get(link, 0))

    def of(self, vehicles: Collection[int]) -> LastMessage | None:
        known = [(src, dst) for dst in vehicles for src in self._into.get(dst, ()) if (src, dst) in self._last]
        if not known:
            return None
        missed = [link for link in known if not self._arrived(self._last[link])]
        if missed:
            link = min(missed, key=lambda one: (self._heard.get(one, -1), one))
        else:
            link = max(known, key=lambda one: (self._last[one].final_tick, one))
        fate, heard = self._last[link], self._heard.get(link)
        how = "corrupted" if fate.cause == Cause.DELIVERED and fate.corrupted else str(fate.cause)
        return LastMessage(
            src=fate.src,
            dst=fate.dst,
            sent_s=fate.sent_tick * self._tick_s,
            at_s=fate.final_tick * self._tick_s,
            fate=how,
            heard_s=None if heard is None else heard * self._tick_s,
        )

    @staticmethod
    def _arrived(fate: Fate) -> bool:
        return fate.cause == Cause.DELIVERED and not fate.corrupted


# --- python check: a check while it is judged: behind a fence, so that whatever it does becomes its verdict


BUDGET_S = 5.0  # of wall time, that one call may take
PATIENCE = 12  # times that, if it hardly computes: a suspended process or a busy machine breaks no check
_MOST_TEXT = 300  # characters of a message, or of a text about what was found
_MOST_PARAMETER = 50  # characters of one in the words of its check
_MOST_VALUES = 100  # of a failure, and vehicles


class CheckError(FleetError):
    """A check in Python cannot be made, or cannot go on; `where` is the file and line at fault, or ""."""

    def __init__(self, check: str, problem: str, where: str = "") -> None:
        super().__init__(f"check {check}: {problem}" + (f" ({where})" if where else ""))
        self.check = check
        self.problem = problem
        self.where = where


class _NoSignal(NamedTuple):
    """Why there is no such signal. A check may ask at every tick, so the words are made when somebody reads them."""

    vehicle: int
    signal: Any
    there: Collection[str]

    def __str__(self) -> str:
        hint = nearest(str(self.signal), self.there) or f"it has {', '.join(self.there)}"
        return f"vehicle {self.vehicle} has no signal {self.signal!r}; {hint}"


class SeenVehicle:
    """One vehicle at one tick, as a check sees it."""

    __slots__ = ("_asked", "_places", "_values", "alive", "id")

    def __init__(
        self, number: int, alive: bool, values: TickValues, places: Mapping[str, SignalPlace], asked: dict[str, None]
    ) -> None:
        """Show a vehicle; `asked` is filled with the names of the signals that are looked at."""
        self.id, self.alive = number, alive
        self._values, self._places, self._asked = values, places, asked

    def __getitem__(self, signal: str) -> Any:
        """The value of a signal; None if the vehicle did not report it at this tick. Raises LookupError if there is no
        such signal.
        """
        place = self._places.get(signal)
        if place is None:
            raise LookupError(_NoSignal(self.id, signal, self._places))
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
        self._vehicles = facts.vehicles
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
                return self._verdict(None, _words(_broken(error)), None)
            self._break(error)
            return self._judged(moment, now, over=over)
        return verdict if margin is None else verdict.with_margin(margin.value, margin.unit, margin.at_s)

    def _judged(self, moment: Moment | None, now: int, *, over: bool) -> Verdict:
        found, value = "as asked", 1.0  # it failed once
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
                    return self._verdict(False if over else None, _words(at_end), value if over else None)
            except CheckError as error:
                if not over:  # it may have too little to go by; whether anybody asks now must change nothing
                    return self._verdict(None, _broken(error).message, None)
                self._break(error)
        if self._failure is None:
            return self._verdict(True, found, 0.0)
        found = f"{_words(self._failure)} at {self._at_s:g} s"
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
            raise self._fence.wrong(tick, method, f"returned {shown(answer)}: expected {expected}") from None

    def _checked(self, tick: int, method: Any, answer: Any) -> Failure | None:
        if answer is None:
            return None
        if not isinstance(answer, Failure):
            expected = "None or a fleet.checks.api.Failure"
            raise self._fence.wrong(tick, method, f"returned {shown(answer)}: expected {expected}")
        message, vehicles, values = answer
        if not isinstance(message, str):
            raise self._fence.wrong(tick, method, f"returned a Failure with message {shown(message)}: expected a text")
        try:
            numbers = tuple(int(i) for i in vehicles)[:_MOST_VALUES]
            found = {str(name): float(value) for name, value in list(values.items())[:_MOST_VALUES]}
        except Exception:  # whatever the user's objects raise when they are asked
            text = f"returned a Failure with vehicles {shown(vehicles)} and values {shown(values)}"
            raise self._fence.wrong(tick, method, f"{text}: expected numbers, and numbers by name") from None
        if strangers := [i for i in numbers if not 1 <= i <= self._vehicles]:
            raise self._fence.wrong(tick, method, f"returned a Failure of vehicle {strangers[0]}: there is none")
        return Failure(" ".join(message.split())[:_MOST_TEXT] or "broken", numbers, found)


def _broken(error: CheckError) -> Failure:
    where = f" ({error.where})" if error.where else ""
    return Failure(f"the check is broken, so nothing is known: {error.problem}{where}")


def _short(parameter: Any) -> str:
    text = shown(parameter).strip("'")
    return text if len(text) <= _MOST_PARAMETER else f"{text[:_MOST_PARAMETER]}..."


def _words(failure: Failure) -> str:
    values = ", ".join(f"{name} {value:.4g}" for name, value in list(failure.values.items())[:4])
    return f"{failure.message}{who(list(failure.vehicles))}{f', {values}' if values else ''}"


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
    )


def packets_of(fates: Iterable[Fate], tick_s: float) -> list[Packet]:
    """Fates as checks see them."""
    return [
        Packet(f.src, f.dst, f.sent_tick * tick_s, f.final_tick * tick_s, str(f.cause), f.corrupted, f.payload)
        for f in fates
    ]


class OwnChecks:
    """The checks of one run that are the user's own."""

    def __init__(self, scenario: Scenario, begin: int = 0, budget_s: float | None = None) -> None:
        """Make them; see `asked`."""
        checks = scenario.spec.checks
        self._scenario, self._tick_s, self._last = scenario, scenario.tick_ns / 1e9, scenario.ticks
        self._places = {i: reported(scenario, i).places() for i in range(1, scenario.vehicles + 1)}
        self._messages = LastMessages(scenario.graph.links, scenario.tick_ns)
        self._signals: list[RunningSignalCheck] = []
        self._python: list[RunningPythonCheck] = []
        facts = facts_of(scenario, begin, self._places) if checks.python else None
        for key, place, name, *_ in checks.own():
            if facts is None or key not in (checks.python or {}):
                asked = ask((checks.signal or [])[place], self._places)
                self._signals.append(RunningSignalCheck(name, asked, scenario, self._places, begin))
            else:
                self._python.append(RunningPythonCheck(name, key, (checks.python or {})[key][place], facts, budget_s))
        self._moments: dict[str, Moment] = {}  # at which checks failed, by name
        self._active: dict[str, Fault] = {}
        self._dead: dict[str, list[int]] = {}  # by fault, whose agents it ended
        self._fates: list[Fate] = []  # since the tick before; only for checks in Python
        self._pending: TickValues | None = None
        self._now = begin

    @classmethod
    def asked(cls, scenario: Scenario, begin: int = 0, budget_s: float | None = None) -> OwnChecks | None:
        """The checks that a scenario asks for; None: it has none. Samples before `begin` do not count. `budget_s`: of a
        call of a check in Python; 0: any; None: `BUDGET_S`. Raises SignalCheckError if no vehicle has the signal of a
        check; CheckError if a check in Python cannot be made.
        """
        checks = scenario.spec.checks
        return cls(scenario, begin, budget_s) if checks.signal or checks.python else None

    @property
    def groups(self) -> frozenset[str]:
        """The topic groups that the checks look at: all, if one is in Python."""
        return frozenset(GROUPS) if self._python else frozenset(check.group for check in self._signals)

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, Error]) -> None:
        if due := due_groups(self._scenario, frame.tick):
            self.take(FrameValues(frame, commands, errors, due))

    def take(self, values: TickValues) -> None:
        self._judge()
        self._pending = values

    def event(self, event: Event) -> None:
        """A fault begins or ends; comes before the values of its tick."""
        if event.action == "ends" and event.tick >= self._last:
            return  # with the run: at its last tick it is still there, and the agent that it ended is not
        self._judge()
        if event.action == "begins":
            if event.is_fault:
                self._active[event.fault] = Fault(event.fault, event.what, event.tick * self._tick_s)
            if dead := _ended(event.what):
                self._dead[event.fault] = dead
        else:
            self._active.pop(event.fault, None)
            self._dead.pop(event.fault, None)
        for check in self._signals:
            check.event(event)

    def settle(self, fate: Fate) -> None:
        """Take a final fate; those of a tick come behind its values."""
        if self._pending is not None and fate.final_tick > self._pending.tick:
            self._judge()
        self._messages.settle(fate)
        if self._python:
            self._fates.append(fate)

    def verdicts(self, *, over: bool) -> list[Verdict]:
        """The verdicts so far, in the order of the scenario. `over`: the run has come to its end."""
        self._judge()
        found = []
        each: list[RunningSignalCheck | RunningPythonCheck] = [*self._signals, *self._python]
        for check in each:
            moment = self._moments.get(check.name)
            verdict = check.verdict(moment, self._now, over=over)
            more = "" if moment is None or verdict.reached is not None else f"; {moment.words}"
            found.append(replace(verdict, found=verdict.found + more))
        return found

    def _judge(self) -> None:
        values, self._pending = self._pending, None
        if values is None:
            return
        tick = self._now = values.tick
        for check in self._signals:
            if (failure := check.step(values)) is not None:
                self._fails(check.name, tick, failure, check.signals)
        if not self._python:
            return
        t, faults = tick * self._tick_s, tuple(self._active.values())
        packets, self._fates = packets_of(self._fates, self._tick_s), []
        dead = {i for vehicles in self._dead.values() for i in vehicles}
        asked: dict[str, None] = {}
        vehicles = [SeenVehicle(i, i not in dead, values, signals, asked) for i, signals in self._places.items()]
        for one in self._python:
            failure = one.step(tick, t, vehicles, faults, packets)
            one.looked_at |= asked
            asked.clear()
            if failure is not None:
                self._fails(one.name, tick, failure, one.looked_at)

    def _fails(self, name: str, tick: int, failure: Failure, signals: Iterable[str]) -> None:
        self._moments[name] = Moment(
            tick,
            tick * self._tick_s,
            list(failure.vehicles),
            {key: value if isfinite(value) else None for key, value in failure.values.items()},
            list(self._active),
            self._messages.of(failure.vehicles, signals),
        )


def due_groups(scenario: Scenario, tick: int) -> frozenset[str]:
    """The topic groups with samples in the log at a tick."""
    every = scenario.log_every
    last = tick == scenario.ticks
    return frozenset(group for group in GROUPS if group in every and (last or tick % every[group] == 0))


def reported(scenario: Scenario, i: int) -> VehicleSignals:
    """The signals of vehicle i in a log; of laws and plants that may not run they are unknown here."""
    try:
        laws = scenario.layout(i)
    except PluginError:
        laws = None
    try:
        plant = scenario.plant_signals(i)
    except PluginError:
        plant = ()
    return VehicleSignals(laws, plant, i in scenario.clocks, scenario.belief(i))


def _ended(what: str) -> list[int]:
    kind, _, vehicles = what.partition(" ")
    if kind not in ("kill", DIVERGED):
        return []
    try:
        return vehicle_numbers(vehicles)
    except QuantityError:  # of a log of another version
        return []
