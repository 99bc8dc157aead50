"""How often each topic group is logged."""

from __future__ import annotations

from math import gcd, lcm

from fleet.scenario.schema.spec import ScenarioSpec, sections
from fleet.scenario.sections.clocks import clock_sections
from fleet.scenario.sections.node_signals import PERIOD_NS
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION, OF_THE_CLOCK, OF_THE_PLANT

LOG_GROUPS = ("pose", "state", "nav", "command", "guidance", "control", "error")
DRAWN_GROUPS = {"transforms": 100_000_000, "scene": 500_000_000}  # topics of the whole fleet: about how often [ns]


def moment_grid(spec: ScenarioSpec) -> int:
    """Ticks between the moments from which a run can go on: rounds with a frame in the log."""
    rounds = 1 if spec.network.ideal else spec.network.period // spec.tick
    return lcm(max(1, rounds), gcd(*log_every(spec).values()))


def log_every(spec: ScenarioSpec) -> dict[str, int]:
    """Ticks between two records of each topic group; 0 for never."""
    if spec.nodes is not None:
        a_round = spec.network.period // spec.tick
        told = {"control": max(1, gcd(PERIOD_NS // spec.tick, a_round))} if spec.signals else {}
        return {"pose": a_round} | told | {group: getattr(spec.log, group) or a_round for group in DRAWN_GROUPS}
    agents = [agent for _, agent in sections(spec, "agent") if agent is not None]
    some = {
        OF_THE_PLANT: any(vehicle.plant is not None for _, vehicle in sections(spec, "vehicle")),
        OF_THE_CLOCK: bool(clock_sections(spec)),
        OF_NAVIGATION: any(its is not None and not its.ideal for _, its in sections(spec, "navigation")),
        OF_LOCALIZATION: any(agent.localization is not None for agent in agents),
    }
    groups = (*LOG_GROUPS, *(group for group, logged in some.items() if logged))
    every = {group: getattr(spec.log, group) or spec.log.every for group in groups}
    step = gcd(*every.values())  # what is drawn shall need no frame of its own
    for group, about_ns in DRAWN_GROUPS.items():
        wanted = getattr(spec.log, group)
        every[group] = max(1, -(-about_ns // (step * spec.tick))) * step if wanted is None else wanted
    return every
