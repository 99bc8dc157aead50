"""Which parts of a scenario are drawn from its seed. If none are, every seed gives the same run.

Each module that draws says so itself: its function `draws` names the purposes (`netem.draws`) whose outcome depends on
the seed. Nobody knows the draws of the users' own laws and plants.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import dist

from fleet.scenario.scenario import Scenario
from fleet.scenario.sections import clocks, formation, graph, liveness, nemesis, partitions, swarm
from netem import access, air, fading, impairment, link_states, link_trace, ranges
from netem.condition import Condition
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace
from world import current, sea, sensors
from world.navigation import config, fixes, instruments, navigator
from world.navigation.config import DeadReckoning

NOTHING = "nothing in this scenario depends on the seed: every seed gives the same run"
HINT = "to make seeds differ, add e.g. initial: {scatter: 1 m}, sensors.position_noise or a loss"
PERHAPS = "perhaps "  # begins the name of a part that may draw


def seeded(scenario: Scenario) -> list[str]:
    """The parts of a scenario that are drawn from the seed, in words; empty if there are none."""
    return list(declared(scenario))


def declared(scenario: Scenario) -> dict[str, list[str]]:
    """By part, in words, the purposes of its draws; unknown ones are left out."""
    found: dict[str, list[str]] = {}
    for part, purposes in _parts(scenario):
        if purposes or part.startswith(PERHAPS):
            found.setdefault(part, []).extend(purposes)
    return found


def _parts(scenario: Scenario) -> Iterator[tuple[str, list[str]]]:
    spec = scenario.spec
    yield "initial scatter", formation.draws(spec.initial)
    yield "random graph", graph.draws(spec.graph, spec.vehicles)
    yield "sensor noise", sensors.draws(scenario.noise)
    for control in scenario.controls:
        if isinstance(own := control.navigation, DeadReckoning):
            of_fixes = [purpose for source in own.fixes for purpose in fixes.draws(source)]
            yield "navigation", [*navigator.draws(own), *instruments.draws(own), *of_fixes]
    for clock in clocks.clock_sections(spec):
        yield "clocks", clocks.draws(clock)
    yield "current", current.draws("", spec.sea.current.sigma)
    for changing in scenario.changing.values():
        yield "link states", link_states.draws(changing) if isinstance(changing, LinkStates) else []
        yield "traces", link_trace.draws(changing) if isinstance(changing, LinkTrace) else []
    for possible in scenario.possible.values():
        for condition in possible:
            yield "link conditions", _of_condition(condition)
    yield from _acoustic(scenario)
    yield "faults", nemesis.draws(scenario.ground)
    yield "faults", swarm.draws(scenario.ground)
    yield "faults", liveness.draws(scenario.ground)
    for number, section in enumerate(spec.faults, start=1):
        if section.partition and section.at // spec.tick < scenario.ticks:
            yield "faults", partitions.draws(section.partition, spec.vehicles, section.id or f"f{number}")
    for fault in scenario.faults.world:
        yield "faults", sea.draws(fault)
        yield "faults", config.draws(fault)
    for over in scenario.faults.network:
        # A seed of a link's own holds for what is put over its condition, too.
        seeds = [known.seed if (known := scenario.conditions.get(link)) else None for link in over.links]
        yield "faults", [] if over.condition is None or None not in seeds else _of_condition(over.condition)
    if scenario.other_laws:
        yield f"{PERHAPS}laws of yours", []
    if scenario.plants:
        yield f"{PERHAPS}plants", []


def _of_condition(condition: Condition) -> list[str]:
    return impairment.draws(condition) if condition.seed is None else []  # one of its own: the scenario's is not asked


def _acoustic(scenario: Scenario) -> Iterator[tuple[str, list[str]]]:
    channel = scenario.acoustic
    if channel is None:
        return
    places = [position for (position, _) in scenario.initial]
    distances = [dist(places[src - 1][:3], places[dst - 1][:3]) for src, dst in scenario.graph.links]
    surely, anywhere = air.draws(channel, distances), air.draws(channel)
    yield f"backoff of {channel.mac}", access.draws(channel)
    yield "measured ranges", ranges.draws(channel.ranging)
    yield "acoustic fading", fading.draws(channel.shadowing, channel.rician)
    if air.CAPTURE in surely:
        yield f"{PERHAPS}collisions", [air.CAPTURE]
    errors = [purpose for purpose in anywhere if purpose == air.SNR]
    if errors:
        yield "acoustic packet errors" if air.SNR in surely else f"{PERHAPS}acoustic packet errors", errors
