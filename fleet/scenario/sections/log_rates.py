"""How often each topic group is logged and a snapshot is taken."""

from __future__ import annotations

from collections.abc import Iterable
from math import gcd, lcm

from agents.config import Law
from agents.controllers import law_class
from fleet.scenario.schema.spec import ScenarioSpec, sections
from fleet.scenario.sections.clocks import clock_sections
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION, OF_THE_CLOCK, OF_THE_PLANT
from world.errors import PluginError
from world.plugins.checks import resumable

SNAPSHOT_NS = 10_000_000_000
LOG_GROUPS = ("pose", "state", "nav", "command", "guidance", "control", "error")
DRAWN_GROUPS = {"transforms": 100_000_000, "scene": 500_000_000}  # topics of the whole fleet: about how often [ns]


def snapshot_grid(spec: ScenarioSpec) -> int:
    """Ticks between the times at which a snapshot is possible: rounds with a frame in the log."""
    rounds = 1 if spec.network.ideal else spec.network.period // spec.tick
    return lcm(max(1, rounds), gcd(*log_every(spec).values()))


def log_every(spec: ScenarioSpec) -> dict[str, int]:
    """Ticks between two records of each topic group; 0 for never."""
    if spec.nodes is not None:
        a_round = spec.network.period // spec.tick
        return {"pose": a_round} | {group: getattr(spec.log, group) or a_round for group in DRAWN_GROUPS}
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


def memory_ticks(spec: ScenarioSpec, others: Iterable[tuple[str, Law]]) -> int:
    """Ticks between two snapshots; 0 for none, also where a law cannot save its state.

    `others`: kind and law of the laws that are not built in.
    """
    if spec.nodes is not None:
        return 0
    wanted = SNAPSHOT_NS if spec.log.snapshot is None else spec.log.snapshot
    if wanted == 0 or without_snapshots(others):
        return 0
    grid = snapshot_grid(spec)
    return max(1, -(-wanted // (grid * spec.tick))) * grid


def without_snapshots(others: Iterable[tuple[str, Law]]) -> list[str]:
    """The names of those laws that cannot save and restore their state; a law that may not run cannot, either."""
    return list(dict.fromkeys(law.name for kind, law in others if not _resumable(kind, law)))


def _resumable(kind: str, law: Law) -> bool:
    try:
        return resumable(law_class(kind, law))
    except PluginError:
        return False
