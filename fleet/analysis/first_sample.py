"""A trial of the user's own code before a run: each law answers one sample, and each plant makes one step."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

from agents.config import Law
from agents.controllers import BUILT_IN, laws
from agents.errors import ControllerError
from agents.make_agent import make_agent
from fleet.errors import Problem, ScenarioError
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Nav
from world.errors import PlantError, PluginError
from world.sea import World
from world.vectors import ZERO


def try_laws(scenario: Scenario) -> None:
    """Make each law that is not built in for the first vehicle that runs it, and give it the first sample of a run: the
    initial state without noise and messages. On an ideal network, where an agent hears at once, the law is only made.
    Laws that may not run, and those of external agents, are left out. Raises ScenarioError with every law that raised,
    or returned what cannot be used.
    """
    tried: list[dict[str, Law]] = []
    problems = []
    for i, control in enumerate(scenario.controls, start=1):
        own = {kind: law for kind, law in laws(control).items() if law.name not in BUILT_IN[kind]}
        if not own or own in tried or control.external:
            continue
        tried.append(own)
        try:
            agent = make_agent(replace(scenario.agent_config(i), on_error="abort"))
            if not scenario.ideal:
                agent.step(Nav(0, 0, *scenario.initial[i - 1]), [])
        except PluginError:  # one that may not run; one that cannot be used was found when the scenario was read
            continue
        except ControllerError as error:
            which = ", ".join(f"{kind} {law.name}" for kind, law in own.items())
            problems.append(Problem(scenario.source, 0, 0, f"{which}: {error}"))
    if problems:
        raise ScenarioError(problems)


def try_plants(scenario: Scenario) -> None:
    """Make the plant of each vehicle, start it, and let it make the first tick of a run, without a command. Raises
    ScenarioError if plants raised, or returned what cannot be used; every one of them is in it.
    """
    if not scenario.plants:
        return
    try:
        config = scenario.world_config
    except PluginError:  # a law that may not run
        return
    tried: set[str] = set()
    problems = []
    for setup in config.vehicles:
        if setup.plant is None:
            continue
        try:
            with closing(World(replace(config, vehicles=(setup,)))) as world:
                world.advance(setup.id, ZERO)
        except PlantError as error:
            if setup.plant.name not in tried:
                problems.append(Problem(scenario.source, 0, 0, f"plant {setup.plant.name}: {error}"))
            tried.add(setup.plant.name)
        except PluginError:  # one that may not run
            continue
    if problems:
        raise ScenarioError(problems)
