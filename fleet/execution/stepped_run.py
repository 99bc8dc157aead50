"""A run that its caller grants tick by tick, looks at and disturbs in between; in one process.

However it is stepped, it is the same run: without disturbance its log has the same bytes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from inspect import signature
from math import dist
from pathlib import Path
from typing import Any, NamedTuple, Never, Protocol, Self

from agents.errors import AgentError
from fleet.analysis.verdicts import judge, standing
from fleet.errors import FleetError, RunBroken
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.external_agents import refuse
from fleet.execution.fault_request import RefusedError
from fleet.execution.in_process import MakeLife, start_in_process
from fleet.execution.operator import Operator
from fleet.execution.outcome import account_for, judge_run, settle
from fleet.execution.triggered import resolve_triggers
from fleet.notebook import html_table
from fleet.quantities import QuantityError, show_time, time_ns
from fleet.recorder.journal import JournalSink
from fleet.recorder.log_file import LogFile, NoDigest, NoLog
from fleet.recorder.metrics import VehicleError
from fleet.recorder.writer import LogWriter
from fleet.result.result import Result, Status, Wall
from fleet.result.verdict import Margin
from fleet.scenario.loading import load_scenario, with_overrides
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text.fault_words import read_fault
from fleet.scenario.text.overrides import FAULT, NET, SET, Override
from netem.parsing import nearest
from netem.wire.messages import Command, Frame, Nav
from world.errors import WorldError
from world.plugins.trust import trusting
from world.vectors import Vec5, plus

Changes = Mapping[str, Any] | Iterable[str]


class VehicleState(NamedTuple):
    """One vehicle between two ticks."""

    id: int
    alive: bool  # whether it has an agent
    eta: Vec5  # true x, y, z [m, NED], theta, psi [rad]
    nu: Vec5  # true u, v, w [m/s, body], q, r [rad/s]
    told: Nav | None  # what its agent was told last: measured or believed, at the tick before; None: nothing yet
    formation_m: float  # how far it is from its place in the formation [m]


class State(NamedTuple):
    """A fleet between two ticks."""

    tick: int  # the next one
    t: float  # when that begins [s]
    vehicles: dict[int, VehicleState]
    faults: tuple[str, ...]  # ids of the active ones

    def _repr_html_(self) -> str:
        rows = [
            (one.id, *(f"{value:.2f}" for value in one.eta[:3]), f"{one.formation_m:.3f}", "" if one.alive else "no")
            for one in self.vehicles.values()
        ]
        title = f"t = {self.t:g} s" + (f", active: {', '.join(self.faults)}" if self.faults else "")
        return html_table(title, ("vehicle", "north [m]", "east [m]", "down [m]", "off its place [m]", "agent"), rows)


class Run:
    """One run in this process, which goes on when it is asked to: step, look, inject.

    `docs/guide/stepping.md` is the guide. At the end of a `with` block the run is closed.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        set: Changes = (),
        net: Iterable[str] = (),
        fault: Iterable[str] = (),
        seed: int | None = None,
        trust: bool = False,
        log: str | Path | None = None,
        **unknown: Never,
    ) -> None:
        """The run before its first tick. Its result is that of `fleet.run`, to the digest.

        Args:
            scenario: a shipped name, a file, or a loaded scenario.
            set: changes of keys, as for `fleet.run`.
            net: conditions of links, as for `fleet.run`.
            fault: faults in the words of `fleet inject`, as for `fleet.run`.
            seed: in place of the scenario's.
            trust: run modules, too, that are neither installed nor the user's own.
            log: a new file that records the run. None: the run is not recorded.

        Raises:
            ScenarioError: with every mistake that was found.
            LogError: the log cannot be created.
            CheckError: a check in Python cannot be made.
            FleetError: somebody else is to start an agent.
            TypeError: an argument is unknown; keys of the scenario go into `set`.
        """
        found = load_for(Run, scenario, set, net, fault, seed, trust, unknown)
        refuse(found, "a run in one process")
        self._prepare(found, None if log is None else LogFile(Path(log)), None, None)

    @classmethod
    def prepared(
        cls,
        scenario: Scenario,
        log: LogFile | NoLog | None = None,
        watcher: Watcher | None = None,
        agents: Mapping[int, MakeLife] | None = None,
    ) -> Self:
        """The run of a scenario that is loaded.

        Args:
            scenario: what is run.
            log: where it is recorded; None: nowhere, with the digest that a log would have.
            watcher: sees every frame.
            agents: by vehicle, what makes an agent in place of the scenario's.

        Returns:
            The run before its first tick.

        Raises:
            CheckError: a check in Python cannot be made.
            FleetError: somebody else is to start an agent.
        """
        run = cls.__new__(cls)
        run._prepare(scenario, log, watcher, agents)
        return run

    def _prepare(
        self,
        scenario: Scenario,
        log: LogFile | NoLog | None,
        watcher: Watcher | None,
        agents: Mapping[int, MakeLife] | None,
    ) -> None:
        refuse(scenario, "a run in one process")
        if agents and scenario.spec.triggers:
            # The moments of triggers are found in a run before, which does not know what these agents will do.
            raise FleetError(
                "triggers: they cannot be combined with agents that are given in Python; leave them out, or inject a "
                "fault when its moment has come"
            )
        self.scenario = scenario = resolve_triggers(scenario)
        self._file = log or NoLog()
        writer = self._file if isinstance(self._file, NoDigest) else LogWriter(self._file, scenario)
        recorded = writer if watcher is None else WatchedLog(writer, watcher)
        self._runner = start_in_process(scenario, recorded, agents=agents)
        self._journal = self._runner.journal
        self._policy = GrantPolicy.of(scenario)
        self._operator = Operator(scenario, self._journal, LiveClock(self._policy, 0.0), self._runner)
        self._result = Result(scenario=scenario.name, seed=scenario.seed, status=Status.PASS)
        self._wall_s = 0.0
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def over(self) -> bool:
        """Whether the run goes no further, because it came to its end, broke, or was closed."""
        return self._closed

    @property
    def tick(self) -> int:
        """The next tick to run. All earlier ticks are over."""
        return self._runner.granted

    @property
    def t(self) -> float:
        """When the next tick begins [s]."""
        return self.tick * self.scenario.tick_ns / 1e9

    @property
    def state(self) -> State:
        """The fleet as it is now, truth included."""
        scenario, world = self.scenario, self._runner.world
        tick_s, dead, vehicles = scenario.tick_ns / 1e9, self._runner.vehicles_without_agent(), {}
        for i in world.ids:
            eta, nu = world.state(i)
            t = world.tick(i) * tick_s  # an agent that answers later is still at the tick before
            place = plus(scenario.reference.at(t).position, scenario.plans[i - 1].at(t).position)
            vehicles[i] = VehicleState(i, i not in dead, eta, nu, self._runner.told.get(i), dist(eta[:3], place))
        tick = min(map(world.tick, world.ids))
        now = min(tick, scenario.ticks - 1)
        active = dict.fromkeys(fault.id for fault in self._operator.faults if fault.active(now))
        return State(tick, tick * tick_s, vehicles, tuple(active))

    @property
    def checks(self) -> list[dict[str, Any]]:
        """The present state of the checks: rows with check, asked, found and passed. None: not judged yet."""
        return standing(self.scenario, self._journal)

    def margin(self, check: str) -> Margin | None:
        """The margin by which a check holds at present. None: the check has no margin, or not yet.

        Args:
            check: name of the check.

        Returns:
            The margin with its unit, and when it was least [s].

        Raises:
            FleetError: the scenario has no such check.
        """
        verdicts = {one.check: one for one in judge(self.scenario, self._journal, middleware_lost=0)}
        if check not in verdicts:
            raise FleetError(f"{self.scenario.name} has no check {check}; it has {', '.join(verdicts) or 'none'}")
        return verdicts[check].margin

    def step(self, by: int | str = 1) -> State:
        """Go on, at most to the end of the run.

        If the run breaks, `over` is True from then on, and `result` says why.

        Args:
            by: a number of ticks, or a time such as "1 s".

        Returns:
            The fleet before the next tick.

        Raises:
            FleetError: the run is over, or the time is no whole number of ticks.
        """
        self.go(_ticks(by, self.scenario.tick_ns))
        return self.state

    def go(self, ticks: int) -> None:
        """As `step`, without computing the state.

        Args:
            ticks: by how many to go on, at most to the end of the run.

        Raises:
            FleetError: the run is over.
        """
        if self._closed:
            raise FleetError(f"the run is over at t = {self.t:g} s: {self._result.reason or 'it came to its end'}")
        with self._going_on():
            self._runner.begin()
            self._runner.advance(min(self.tick + ticks, self.scenario.ticks))
        if self._runner.finished:
            self._finish()

    def answer(self, i: int, answers: list[Any]) -> None:
        """Take the answers of an agent that answers later than it is asked.

        Args:
            i: number of its vehicle.
            answers: its messages, in their order.
        """
        with self._going_on():
            self._runner.answer(i, answers)
        if self._runner.finished:
            self._finish()

    def inject(self, fault: str) -> str:
        """Begin a fault at the next tick.

        Args:
            fault: in the words of `fleet inject`, such as "down 1<->2 for 5s".

        Returns:
            Its id, for `heal`.

        Raises:
            RefusedError: the fault is not possible in this scenario, or the run is over.
            FaultWordsError: the words are no fault.
        """
        found: str = self._ask(op="inject", fault=read_fault(fault))["id"]
        return found

    def heal(self, fault: str | None = None) -> list[str]:
        """End a fault at the next tick. A killed agent begins again with the next round.

        Args:
            fault: id of the fault. None: all active faults.

        Returns:
            The ids of the healed faults.

        Raises:
            RefusedError: there is no such fault, or the run is over.
        """
        found: list[str] = self._ask(op="heal", id=fault)["healed"]
        return found

    def heal_as(self, scenario: Scenario) -> None:
        """End all faults at the next tick, and let none begin later.

        Args:
            scenario: the same with the faults ended then. The run goes on as one of it, and its checks judge the run.

        Raises:
            RefusedError: agents cannot begin again in time.
        """
        for kill in self._operator.end_faults():
            self._runner.spare_agents(kill)
        self.scenario = scenario

    @property
    def can_be_copied(self) -> bool:
        """Whether a copy of this process can go on with the run."""
        return self._runner.can_be_copied

    def to_end(self, progress: Callable[[float], None] | None = None) -> Result:
        """Go on to the end of the run.

        Args:
            progress: called with the simulated time [s] all the time.

        Returns:
            The verdicts and all numbers, also of a run that broke.
        """
        tick_s = self.scenario.tick_ns / 1e9

        def on_progress() -> None:
            if progress is not None:
                progress(max(0, self._journal.written) * tick_s)

        if not self._closed:
            with self._going_on():
                self._runner.serve(self._policy, on_progress)
                on_progress()
            self._finish(ended=True)
        return self.result

    def close(self) -> None:
        """End the run where it is."""
        if not self._closed:
            self._result.status = Status.INTERRUPTED
            self._result.reason = f"it was closed at t = {self.t:g} of {show_time(self.scenario.duration_ns)}"
            self._finish(ended=True)

    @property
    def result(self) -> Result:
        """The verdicts and all numbers, as of `fleet.run`.

        Raises:
            FleetError: the run still goes on.
        """
        if not self._closed:
            raise FleetError(f"the run goes on at t = {self.t:g} s: step on, or call to_end() or close()")
        return self._result

    @contextmanager
    def _going_on(self) -> Iterator[None]:
        began, result = time.monotonic(), self._result
        try:
            yield
        except RunBroken as error:
            result.status, result.reason, result.lines = Status.BROKEN, error.reason, error.lines
        except (AgentError, WorldError) as error:
            result.status, result.reason = Status.BROKEN, str(error)
        self._wall_s += time.monotonic() - began
        if result.status is Status.BROKEN:
            self._finish(ended=True)

    def _finish(self, *, ended: bool = False) -> None:
        """Judge the run; `ended`: what was on the way is accounted for, or is not to be."""
        if self._closed:
            return
        self._closed = True
        if not ended:
            self._runner.end()
        self._runner.release()
        journal, result = self._journal, self._result
        settle(journal, self._file, self._runner, result)
        judge_run(self.scenario, journal, result, lost=0)
        wall = Wall(in_process=True, run_s=self._wall_s)
        account_for(result, self.scenario, journal, self._file, self._runner, wall)

    def _ask(self, **request: Any) -> dict[str, Any]:
        if self._closed:
            raise RefusedError(f"the run is over at t = {self.t:g} s")
        answer = self._operator.handle(request)
        if "error" in answer:
            raise RefusedError(answer["error"], answer["status"])
        return answer


def _ticks(by: int | str, tick_ns: int) -> int:
    text = f"step({by!r})"
    try:
        ns = time_ns(by) if isinstance(by, str) else by * tick_ns
    except QuantityError as error:
        raise FleetError(f'{text}: {error}; expected a number of ticks, or a time such as "1 s"') from None
    if not isinstance(ns, int) or ns < tick_ns or ns % tick_ns:
        raise FleetError(f"{text}: expected a whole number of ticks of {show_time(tick_ns)}, 1 or more")
    return ns // tick_ns


def load_for(
    function: Callable[..., Any],
    scenario: str | Path | Scenario,
    set: Changes,
    net: Iterable[str],
    fault: Iterable[str],
    seed: int | None,
    trust: bool,
    unknown: Mapping[str, Any] | None = None,
) -> Scenario:
    """The scenario that a function was given, with the changes.

    Args:
        function: the function, for the words about an unknown argument.
        scenario: a shipped name, a file, or a loaded scenario.
        set: changes, as for `fleet.run`; so `net`, `fault`, `seed` and `trust`.
        net: conditions of links.
        fault: further faults.
        seed: replaces the scenario's seed.
        trust: run modules, too, that are neither installed nor the user's own.
        unknown: arguments that the function does not have.

    Returns:
        The scenario with every change in it.

    Raises:
        ScenarioError: with every mistake that was found.
        TypeError: an argument is unknown.
    """
    if unknown:
        name = next(iter(unknown))
        keys = {key: unknown[key] for key in unknown if key in ScenarioSpec.model_fields}
        known = [key for key in signature(function).parameters if key not in ("self", "unknown")]
        hint = nearest(name, known, 0.7) or f"it has {', '.join(known)}"
        if keys:
            hint = f"keys of the scenario go into set={keys}"
        raise TypeError(f"{function.__name__}() has no argument {name!r}; {hint}")
    for name, some in (("net", net), ("fault", fault)):
        if isinstance(some, str):
            raise TypeError(f"{name}: expected a list of texts, got {some!r}")
    changes = [Override.of(text) for text in override_texts(set)]
    changes += [Override(NET, text) for text in net] + [Override(FAULT, text) for text in fault]
    if seed is not None:
        changes.append(Override(SET, f"seed={seed}"))
    with trusting(trust):
        if not isinstance(scenario, Scenario):
            return load_scenario(scenario, changes)
        return with_overrides(scenario, changes) if changes else scenario


def override_texts(changes: Changes) -> list[str]:
    """Changes as the texts of `--set`.

    Args:
        changes: a mapping of keys to values, or such texts.

    Returns:
        Texts such as `duration=20 s`.

    Raises:
        TypeError: they are neither a mapping nor texts.
    """
    if isinstance(changes, str):
        raise TypeError(f'set: expected a mapping or a list of texts such as ["duration=20 s"], got {changes!r}')
    if isinstance(changes, Mapping):
        # JSON is YAML, so a mapping or a list inside comes through.
        return [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in changes.items()]
    return [str(change) for change in changes]


class Watcher(Protocol):
    """Sees every frame, with its decoded commands and errors by vehicle."""

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None: ...


class WatchedLog:
    """A sink of the journal that passes everything on."""

    def __init__(self, log: JournalSink, watcher: Watcher) -> None:
        self._log, self._watcher = log, watcher
        self.packet, self.event = log.packet, log.event

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        self._log.frame(frame, commands, errors)
        self._watcher.frame(frame, commands, errors)
