"""The checks of one run that are the user's own: fed in the order of the log, judged at any time.

A tick is judged when everything of it is known: when something later comes, or a verdict is asked for. So the report
can name a message that arrives at the very tick of the failure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isfinite

from msgspec.structs import replace

from fleet.checks.api import Failure, Fault
from fleet.checks.last_messages import LastMessages
from fleet.checks.python_check import RunningPythonCheck, SeenVehicle, facts_of, packets_of
from fleet.checks.signal_check import RunningSignalCheck
from fleet.checks.values import Error, FrameValues, TickValues
from fleet.quantities import QuantityError, vehicle_numbers
from fleet.result.verdict import Moment, Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signal_checks import ask
from fleet.scenario.sections.signals import GROUPS, VehicleSignals
from fleet.scenario.sections.timeline import Event
from fleet.scenario.sections.vehicle_events import DIVERGED
from netem.wire.messages import Command, Fate, Frame
from world.errors import PluginError


class OwnChecks:
    """The checks of one run that are the user's own."""

    def __init__(self, scenario: Scenario, begin: int = 0) -> None:
        """Make them; see `asked`."""
        checks = scenario.spec.checks
        self._tick_s, self._last = scenario.tick_ns / 1e9, scenario.ticks
        self._every = {group: scenario.log_every[group] for group in GROUPS if group in scenario.log_every}
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
                self._python.append(RunningPythonCheck(name, key, (checks.python or {})[key][place], facts))
        self._moments: dict[str, Moment] = {}  # at which checks failed, by name
        self._active: dict[str, Fault] = {}
        self._dead: dict[str, list[int]] = {}  # by fault, whose agents it ended
        self._fates: list[Fate] = []  # since the tick before; only for checks in Python
        self._pending: TickValues | None = None
        self._now = begin

    @classmethod
    def asked(cls, scenario: Scenario, begin: int = 0) -> OwnChecks | None:
        """The checks that a scenario asks for; None: it has none.

        Args:
            scenario: the scenario.
            begin: first tick of the run. Earlier samples do not count.

        Raises:
            SignalCheckError: no vehicle of the scenario has the signal of a check.
            CheckError: a check in Python cannot be made.
        """
        checks = scenario.spec.checks
        return cls(scenario, begin) if checks.signal or checks.python else None

    @property
    def groups(self) -> frozenset[str]:
        """The topic groups that the checks look at: all, if one is in Python."""
        return frozenset(GROUPS) if self._python else frozenset(check.group for check in self._signals)

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, Error]) -> None:
        """Take a frame, with all vehicles in it."""
        if due := self.due(frame.tick):
            self.take(FrameValues(frame, commands, errors, due))

    def due(self, tick: int) -> frozenset[str]:
        """The topic groups with samples in the log at a tick."""
        return frozenset(group for group, every in self._every.items() if tick % every == 0 or tick == self._last)

    def take(self, values: TickValues) -> None:
        """Take the values of a tick."""
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
        """The verdicts so far, in the order of the scenario.

        Args:
            over: the run has come to its end.
        """
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
        """Show the checks the tick that is known by now."""
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


def reported(scenario: Scenario, i: int) -> VehicleSignals:
    """The signals of vehicle i in a log.

    If the laws and plants of a log may not run, their signals are unknown here.
    """
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
    """The vehicles whose agents a fault has ended, or that have diverged."""
    kind, _, vehicles = what.partition(" ")
    if kind not in ("kill", DIVERGED):
        return []
    try:
        return vehicle_numbers(vehicles)
    except QuantityError:  # of a log of another version
        return []
