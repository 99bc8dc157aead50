"""The checks of one run that are the user's own: fed in the order of the log, judged at any time.

A tick is judged when everything of it is known: when something later comes, or a verdict is asked for. So the report
can name a message that arrives at the very tick of the failure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import isfinite

from msgspec.structs import replace

from agents.message import VERSION
from fleet.checks.api import Failure, Fault
from fleet.checks.python_check import RunningPythonCheck, SeenVehicle, facts_of, packets_of
from fleet.checks.signal_check import RunningSignalCheck
from fleet.checks.values import Error, FrameValues, TickValues
from fleet.logs.payload_kinds import STATE, kind_of
from fleet.result.verdict import LastMessage, Moment, Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.fault_entry import DIVERGED, entry_kind, entry_vehicles, words_of
from fleet.scenario.sections.node_signals import node_signals
from fleet.scenario.sections.signal_checks import ask
from fleet.scenario.sections.signals import GROUPS, VehicleSignals
from fleet.scenario.sections.timeline import Event
from netem.cause import Cause
from netem.condition import Link
from netem.wire.messages import Command, Fate, Frame
from world.errors import PluginError

_OF_A_PROTOCOL = bytes((VERSION,))  # begins every message that `agents.api.pack` makes


class OwnChecks:
    """The checks of one run that are the user's own."""

    def __init__(self, scenario: Scenario, begin: int = 0, budget_s: float | None = None) -> None:
        """Make them; see `from_scenario`."""
        checks = scenario.spec.checks
        self._scenario, self._tick_s, self._last = scenario, scenario.tick_ns / 1e9, scenario.ticks
        self._names = scenario.names
        self._places = {i: logged_signals(scenario, i).places() for i in range(1, scenario.vehicles + 1)}
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
        self._dead: dict[str, Sequence[int]] = {}  # by fault, whose agents it ended
        self._paused: dict[str, Sequence[int]] = {}
        self._fates: list[Fate] = []  # since the tick before; only for checks in Python
        self._pending: TickValues | None = None
        self._now = begin

    @classmethod
    def from_scenario(cls, scenario: Scenario, begin: int = 0, budget_s: float | None = None) -> OwnChecks | None:
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
                # Checks know vehicles by their numbers.
                what = words_of(event.entry) if event.entry else event.what
                self._active[event.fault] = Fault(event.fault, what, event.tick * self._tick_s, event.entry)
            kind, who = entry_kind(event.entry), entry_vehicles(event.entry)
            self._dead[event.fault] = who if kind in ("kill", DIVERGED) else ()
            self._paused[event.fault] = who if kind == "pause" else ()
        else:
            for known in (self._active, self._dead, self._paused):
                known.pop(event.fault, None)
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
            if moment is not None and verdict.reached is None:
                verdict = replace(verdict, found=f"{verdict.found}; {moment.words(self._names)}")
            found.append(verdict)
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
        dead = _all(self._dead)
        asked: dict[str, None] = {}
        vehicles = [
            SeenVehicle(i, i not in dead, values, signals, asked, self._names) for i, signals in self._places.items()
        ]
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
            self._messages.of(failure.vehicles, signals, _all(self._dead) | _all(self._paused)),
        )


def due_groups(scenario: Scenario, tick: int) -> frozenset[str]:
    """The topic groups with samples in the log at a tick."""
    every = scenario.log_every
    last = tick == scenario.ticks
    return frozenset(group for group in GROUPS if group in every and (last or tick % every[group] == 0))


def logged_signals(scenario: Scenario, i: int) -> VehicleSignals:
    """The signals of vehicle i in a log; of laws and plants that may not run they are unknown here."""
    if scenario.nodes:
        return node_signals(scenario.spec, i)
    try:
        laws = scenario.layout(i)
    except PluginError:
        laws = None
    try:
        plant = scenario.plant_signals(i)
    except PluginError:
        plant = ()
    return VehicleSignals(laws, plant, i in scenario.clocks, scenario.belief(i))


def _all(by_fault: Mapping[str, Sequence[int]]) -> set[int]:
    return {i for vehicles in by_fault.values() for i in vehicles}


class LastMessages:
    """For each link and protocol: the last fate, and the sending time of the newest message that arrived whole.

    So it can be told which message made the difference to a vehicle.

    Only messages of the protocol that a check judges count. Which these are is told by the signals that the check looks
    at:

    | signals | messages |
    |---|---|
    | `control` | those of the agent's own protocol (all kinds but state messages); if it sends none, state messages |
    | `guidance`, `error` | state messages, by which the formation is kept |
    | all others | none: a depth or a force is not judged by what was heard |
    """

    def __init__(self, links: Sequence[Link], tick_ns: int) -> None:
        self._states, self._own = _LastOfLinks(links, tick_ns / 1e9), _LastOfLinks(links, tick_ns / 1e9)

    def settle(self, fate: Fate) -> None:
        own = fate.payload[:1] == _OF_A_PROTOCOL or kind_of(fate.payload) != STATE
        (self._own if own else self._states).settle(fate)

    def of(self, vehicles: Collection[int], signals: Iterable[str], silent: Collection[int] = ()) -> LastMessage | None:
        """The message that made the difference to the vehicles that failed a check.

        It is the last one of a link whose last packet was lost, or whose sender is silent. Of several such links that
        one counts which has heard nothing for the longest time. If there is none, it is the packet that arrived last.
        None: the check judges no protocol, or no packet of it has had a fate yet.

        Args:
            vehicles: that failed it.
            signals: that it looks at.
            silent: the vehicles that send nothing, as their agent is gone or paused.
        """
        groups = {signal.lstrip("| ").partition(".")[0] for signal in signals}
        if "control" in groups:
            return (self._own if self._own.any else self._states).of(vehicles, silent)
        return self._states.of(vehicles, silent) if groups & {"guidance", "error"} else None


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

    def of(self, vehicles: Collection[int], silent: Collection[int]) -> LastMessage | None:
        known = [(src, dst) for dst in vehicles for src in self._into.get(dst, ()) if (src, dst) in self._last]
        if not known:
            return None
        missed = [link for link in known if link[0] in silent or not self._arrived(self._last[link])]
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
            silent=fate.src in silent,
        )

    @staticmethod
    def _arrived(fate: Fate) -> bool:
        return fate.cause == Cause.DELIVERED and not fate.corrupted
