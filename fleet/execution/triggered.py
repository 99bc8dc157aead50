"""The faults that the triggers of a scenario begin, found in a run in this process before the run that counts.

A run is a function of its scenario. So the run with these faults at these times is the run with the triggers, and
whatever replays, verifies or shrinks a run needs to know nothing about triggers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from agents.errors import AgentError
from fleet.checks.own_checks import due_groups
from fleet.checks.triggers import Triggers
from fleet.checks.values import FrameValues
from fleet.errors import RunBroken
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.external_agents import refuse
from fleet.execution.in_process import start_in_process
from fleet.execution.moments import reach
from fleet.execution.operator import Operator
from fleet.recorder.metrics import VehicleError
from fleet.recorder.start import Start
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.sections.timeline import Event
from fleet.scenario.text.scenario_yaml import scenario_yaml
from netem.wire.messages import Command, Fate, Frame
from world.errors import WorldError


def resolve_triggers(scenario: Scenario, start: Start | None = None) -> Scenario:
    """The scenario with the faults that its triggers begin in place of these; itself if it has none.

    Args:
        start: where the run that counts goes on; None: it begins at t = 0.

    Raises:
        ScenarioError: a module of it may not run.
        FleetError: somebody else is to start an agent.
    """
    if not scenario.spec.triggers:
        return scenario
    refuse(scenario, "a scenario with triggers")
    calm, looks = _with(scenario, ()), _Looks(scenario, goes_on=start is not None)
    before = None if start is None else reach(replace(start, recorded=None)).run
    runner = start_in_process(calm, looks, before, judged=False)
    operator = Operator(calm, runner.journal, LiveClock(GrantPolicy.of(calm), 0.0), runner)
    try:
        runner.begin()
        while looks.triggers.waiting and not runner.finished:
            for section in looks.due(runner.granted * scenario.tick_ns):
                operator.add(section, section.id or "")
            runner.advance(runner.granted + 1)
    except (AgentError, WorldError, RunBroken):
        pass  # as the run that counts will, and what comes after that begins nothing
    finally:
        runner.release()
    return _with(scenario, looks.triggers.begun)


class _Looks:
    """A sink of the journal that shows each frame to the triggers, and records nothing."""

    def __init__(self, scenario: Scenario, *, goes_on: bool) -> None:
        self.triggers, self._scenario = Triggers(scenario, goes_on=goes_on), scenario
        self._next: list[FaultSection] = []

    def due(self, at_ns: int) -> list[FaultSection]:
        """The faults that begin now."""
        found = [section for section in self._next if section.at <= at_ns]
        self._next = [section for section in self._next if section.at > at_ns]
        return found

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        due = due_groups(self._scenario, frame.tick)
        self._next += self.triggers.look(FrameValues(frame, commands, errors, due))

    def packet(self, fate: Fate) -> None: ...

    def event(self, event: Event) -> None: ...


def _with(scenario: Scenario, faults: Sequence[FaultSection]) -> Scenario:
    """The same scenario with further faults and without triggers."""
    spec, reading = scenario.spec, scenario.reading
    text = scenario_yaml(spec.model_copy(update={"triggers": [], "faults": [*spec.faults, *faults]}))
    return parse_scenario(text, scenario.source, (), reading.folder, replace(reading.policy, refused=None))
