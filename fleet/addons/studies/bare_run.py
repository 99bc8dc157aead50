"""Runs of moored vehicles with nothing around their agents but the network and the scenario's own checks.

A search makes hundreds of runs, and nobody reads their logs. So there is no journal here, no metrics, no messages
between processes. Its verdicts are those of the emulator: the tests compare them. A search repeats the first run of
each kind of failure in the emulator, which gives the digest, and only that counts.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from typing import NamedTuple, TypeVar

import msgpack

from agents.config import AgentConfig
from agents.loop import AgentLoop
from agents.make_agent import make_agent
from fleet.addons.studies.errors import StudyError
from fleet.checks.own_checks import OwnChecks, due_groups
from fleet.checks.triggers import Triggers
from fleet.checks.values import Values
from fleet.errors import FleetError
from fleet.result.verdict import Verdict
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.timeline import begin_and_end, event_order, parts
from netem.faults import NetFault
from netem.lives import Lives
from netem.network import Netem
from netem.wire.messages import FAILED, Command, Fate, Inbox, Nav, TimedFault, Transmission, WorldFault
from world.plugins.fence import OverBudgetError, alarm
from world.plugins.kept_files import KeptFiles, files_are_kept
from world.sea import World

BUDGET_S = 600.0  # of wall time; what takes longer is left to the emulator, which limits each call of a check
# Checks that a bare run leaves out: of the emulator's own work, and of what never happens to a moored vehicle.
_LEFT_OUT = frozenset({"ledger", "middleware_loss", "tumbled", "deaths", "qp_infeasible", "programs"})


def fits(scenario: Scenario) -> bool:
    """Whether a bare run can judge a scenario: it has moored vehicles, and only checks of signals or in Python.

    How programs end is not seen there; so what were nodes, whose check of programs is stated, are left to the emulator.
    """
    spec = scenario.spec
    if spec.names and spec.checks.programs is not None:
        return False
    others = {key for key, value in spec.checks if value is not None} - {"signal", "python"} - _LEFT_OUT
    plain = spec.expect == "pass" and not (scenario.ideal or scenario.external)
    return bool(spec.moored) and plain and not others and bool(spec.checks.own())


def bare_verdicts(scenario: Scenario, progress: Callable[[float], None] | None = None) -> list[Verdict]:
    """The verdicts of a scenario's own checks. Empty: the emulator has to judge this run.

    Args:
        progress: called with the simulated time [s] in each round.

    Raises:
        StudyError: `progress` raised it.
    """
    try:
        run = _BareRun(scenario)
        # One alarm for the whole run: one for each call of a check would take a fifth of its time.
        here = threading.current_thread() is threading.main_thread()  # only there signals arrive
        with alarm(BUDGET_S, 0.0, lambda: True) if here else nullcontext():
            return run.to_end(progress)
    except StudyError:  # it took too long
        raise
    except (Exception, OverBudgetError):  # a law failed, or a check asks for what is not here: the emulator says which
        return []


_Timed = TypeVar("_Timed", bound=TimedFault)


def _sort_faults(*faults: _Timed) -> tuple[_Timed, ...]:
    """The faults in the order in which they begin."""
    return tuple(sorted(faults, key=lambda fault: fault.begin))


class _Values(NamedTuple):
    """The reports of the vehicles at a tick, as checks see them."""

    tick: int
    due: frozenset[str]
    known: dict[int, dict[str, Values]]  # by vehicle and topic group

    def values(self, i: int, group: str) -> Values:
        if group not in self.due:
            return ()
        return self.known[i][group]


class _BareRun:
    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        checks = OwnChecks.from_scenario(scenario, budget_s=0.0)
        assert checks is not None
        self._checks = checks
        self._world, self._network = World(scenario.world_config), Netem(scenario.netem_config)
        self._lives = Lives(scenario.world_config.absences)
        self._loops: dict[int, AgentLoop] = {}  # by vehicle: the life of its agent
        self._kept = KeptFiles()
        self._events, self._fates = deque(scenario.faults.events), deque[Fate]()
        self._frames = deque[_Values]()
        self._frame_every = frame_every(scenario)
        self.triggers = Triggers(scenario) if scenario.spec.triggers else None
        still = {i: self._world.state(i) for i in self._world.ids}
        self._state: dict[int, Values] = {i: (*eta, *nu) for i, (eta, nu) in still.items()}
        self._places = {i: eta[:3] for i, (eta, _) in still.items()}
        packed = {i: msgpack.packb(scenario.agent_config(i).to_values()) for i in still}
        self._configs = {i: AgentConfig.from_values(msgpack.unpackb(data)) for i, data in packed.items()}

    def to_end(self, progress: Callable[[float], None] | None) -> list[Verdict]:
        scenario, network = self._scenario, self._network
        m, tick_s, last = scenario.round_ticks, scenario.tick_ns / 1e9, scenario.ticks
        for k in range(last):
            begins_round = k % m == 0
            sent: dict[int, tuple[bytes, ...]] = {}
            known: dict[int, dict[str, Values]] = {}
            alive: dict[int, tuple[float, ...]] = {}
            for i, state in self._state.items():
                known[i] = groups = {"state": state, "nav": (), "control": (), "guidance": ()}
                if (loop := self._loop(i, k)) is not None:
                    alive[i] = self._places[i]
                    if not self._world.paused(i, k):
                        self._step(i, k, loop, sent, groups)
                self._world.hold(i)
            self._frame(k, known)
            if begins_round:
                inboxes, fates = network.exchange(k, sent, alive)
                for i, deliveries in inboxes.items():
                    loop = self._loops[i]
                    loop.inbox(Inbox(loop.incarnation, k + m, False, deliveries))
                self._fates += fates
                self._take(k)
                if progress is not None:
                    progress(k * tick_s)
        nothing: dict[str, Values] = {"nav": (), "control": (), "guidance": ()}
        self._frame(last, {i: {"state": state, **nothing} for i, state in self._state.items()})
        self._fates += network.close(last)
        self._take(last)
        return self._checks.verdicts(over=True)

    def _loop(self, i: int, k: int) -> AgentLoop | None:
        """The agent of vehicle i at tick k, perhaps a new one; None: it has none."""
        if self._lives.lacks_agent(i, k):
            return None
        life = self._lives.incarnation(i, k)
        if i not in self._loops or self._loops[i].incarnation != life:
            with files_are_kept(self._kept):
                core = make_agent(self._configs[i])
            self._loops[i] = AgentLoop(core, self._scenario.round_ticks, incarnation=life, begin=k)
        return self._loops[i]

    def _step(
        self, i: int, k: int, loop: AgentLoop, sent: dict[int, tuple[bytes, ...]], groups: dict[str, Values]
    ) -> None:
        """Let agent i answer the sample of tick k. `sent` takes its payloads, `groups` what it measured and reports."""
        world = self._world
        clocks = world.clocks
        eta, nu, roll = world.sense(i)
        groups["nav"] = eta + nu + roll
        nav = Nav(loop.incarnation, k, eta, nu, roll, None if clocks is None else clocks.reading_ns(i, k))
        for answer in loop.nav(nav):
            if isinstance(answer, Transmission):
                sent[i] = answer.payloads
            elif isinstance(answer, Command):
                if self._scenario.spec.checks.programs is None and any(one.stream == FAILED for one in answer.said):
                    raise FleetError("a program failed, and the emulator says how")
                groups["control"] = groups["guidance"] = answer.telemetry

    def _frame(self, k: int, known: dict[int, dict[str, Values]]) -> None:
        if k % self._frame_every == 0 or k == self._scenario.ticks:
            values = _Values(k, due_groups(self._scenario, k), known)
            self._frames.append(values)
            if self.triggers is not None:
                for fault in self.triggers.look(values):
                    self._begin(fault)

    def _begin(self, fault: FaultSection) -> None:
        """Add a fault that a trigger begins."""
        scenario, name = self._scenario, fault.id or ""
        found = parts(fault, name, scenario.spec, scenario.graph.links)
        for part in found:
            if isinstance(part, Kill):
                for absence in part.absences:
                    self._lives.add(absence)
        network, world = self._network, self._world
        network.faults = _sort_faults(*network.faults, *(part for part in found if isinstance(part, NetFault)))
        world.faults = _sort_faults(*world.faults, *(part for part in found if isinstance(part, WorldFault)))
        events = begin_and_end(found, fault, scenario.ticks)
        self._events = deque(sorted((*self._events, *events), key=event_order))

    def _take(self, limit: int) -> None:
        """Show the checks everything up to a tick, in the order of a log."""
        checks, events = self._checks, self._events
        while self._frames and self._frames[0].tick <= limit:
            values = self._frames.popleft()
            self._settle(values.tick - 1)
            while events and events[0].tick <= values.tick:
                checks.event(events.popleft())
            if values.due:
                checks.take(values)
        self._settle(limit)

    def _settle(self, until: int) -> None:
        while self._fates and self._fates[0].final_tick <= until:
            self._checks.settle(self._fates.popleft())
