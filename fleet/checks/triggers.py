"""The triggers of one run while they wait: they look at what agents report, and say which faults begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isnan

from fleet.checks.own_checks import due_groups, logged_signals
from fleet.checks.values import TickValues
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection, TriggerSection
from fleet.scenario.sections.signals import SignalPlace
from fleet.scenario.sections.timeline import acts, parts
from fleet.scenario.sections.triggers import AskedMoment, ask_moment, fault_of, trigger_name, wait_ns


@dataclass(slots=True)
class _Waiting:
    trigger: TriggerSection
    name: str
    asked: AskedMoment
    left: int  # such moments until it begins
    known: dict[int, float | bool] = field(default_factory=dict)  # by vehicle: its value, or whether it holds

    def moment(self, i: int, value: float | None) -> bool:
        """Take a sample of vehicle i, None if there is none; whether it is such a moment."""
        before = self.known.pop(i, None)
        if value is None:
            return False
        condition = self.asked.condition
        now = value if condition is None else condition.holds(value)
        self.known[i] = now
        return before is not None and now != before if condition is None else bool(now) and not before


class Triggers:
    """The triggers of a scenario that have not begun."""

    def __init__(self, scenario: Scenario, *, goes_on: bool = False) -> None:
        """Begin to look. `goes_on`: at a run that goes on from another. What holds in its first samples is no moment,
        as it may have held before.
        """
        spec = self._spec = scenario.spec
        self._scenario, self._tick_ns = scenario, scenario.tick_ns
        self._places: dict[int, Mapping[str, SignalPlace]] = {
            i: logged_signals(scenario, i).places() for i in range(1, scenario.vehicles + 1)
        }
        self._waiting = [
            _Waiting(trigger, trigger_name(trigger, number), ask_moment(trigger.when, self._places), trigger.nth)
            for number, trigger in enumerate(spec.triggers, start=1)
        ]
        for one in self._waiting if goes_on else ():
            if one.asked.condition is not None:
                one.known = dict.fromkeys(one.asked.vehicles, True)
        self.begun: list[FaultSection] = []  # in the order of their moments

    @property
    def waiting(self) -> bool:
        """Whether a trigger has not begun yet."""
        return bool(self._waiting)

    def look(self, values: TickValues) -> list[FaultSection]:
        """The faults that a tick's samples begin; each begins a round later, at the earliest."""
        due = due_groups(self._scenario, values.tick)
        waiting = [one for one in self._waiting if one.asked.signal.group in due]
        found = [fault for one in waiting if (fault := self._begins(one, values)) is not None]
        self._waiting = [one for one in self._waiting if one.left]
        self.begun += found
        return found

    def _begins(self, one: _Waiting, values: TickValues) -> FaultSection | None:
        signal, tick, spec = one.asked.signal, values.tick, self._spec
        at_ns, when = tick * self._tick_ns, one.trigger.when
        if at_ns < when.after or (when.before is not None and at_ns >= when.before):
            return None
        for i in one.asked.vehicles:
            place = self._places[i].get(signal.name)
            numbers = () if place is None else values.values(i, signal.group)[place.values]
            value = signal.value(numbers) if numbers else None
            one.left -= one.moment(i, None if value is None or isnan(value) else value)
            if not one.left:
                return self._fault(one, at_ns + wait_ns(one.trigger, spec), i)
        return None

    def _fault(self, one: _Waiting, at_ns: int, i: int) -> FaultSection | None:
        """The fault that vehicle i begins. A trigger ends with its moment, also if its fault acts on nothing."""
        spec, graph = self._spec, self._scenario.graph
        fault = fault_of(one.trigger, one.name, at_ns, i, spec, [j for j, _ in graph.neighbours(i)])
        if fault is None or at_ns >= spec.duration:
            return None
        return fault if acts(parts(fault, one.name, spec, graph.links)) else None
