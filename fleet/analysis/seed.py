"""Which parts of a scenario are drawn from its seed. If none are, every seed gives the same run."""

from __future__ import annotations

from collections.abc import Iterator

from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.partitions import is_drawn
from netem.condition import Condition
from netem.faults import NetFault
from world.faults import WorldFault

NOTHING = "nothing in this scenario depends on the seed: every seed gives the same run"
HINT = "initial: {scatter: 1 m}, sensors.position_noise or a loss would make seeds differ"


def seeded(scenario: Scenario) -> list[str]:
    """The parts of a scenario that are drawn from the seed, in words; empty if there are none."""
    return list(dict.fromkeys(_seeded(scenario)))


def _seeded(scenario: Scenario) -> Iterator[str]:
    spec = scenario.spec
    if spec.initial.scatter is not None and spec.initial.scatter.scatter > 0.0:
        yield "initial scatter"
    if spec.graph.shape == "random":
        yield "random graph"
    sensors = spec.sensors
    if sensors.position_noise or sensors.angle_noise or sensors.velocity_noise or sensors.rate_noise:
        yield "sensor noise"
    if any(spec.sea.current.sigma):
        yield "current"
    if any(_drawn(condition) for condition in scenario.conditions.values()):
        yield "link conditions"
    acoustic = scenario.acoustic
    if acoustic is not None and acoustic.mac == "aloha" and acoustic.backoff_ticks:
        yield "backoff of aloha"
    sections = zip((f.id or f"f{n}" for n, f in enumerate(spec.faults, start=1)), spec.faults, strict=True)
    drawn = {name for name, section in sections if section.partition and is_drawn(section.partition)}
    for part in scenario.faults.parts:
        random = isinstance(part, NetFault) and part.condition is not None and _drawn(part.condition)
        random |= isinstance(part, WorldFault) and part.kind in ("noise", "dropout")
        random |= isinstance(part, WorldFault) and part.kind == "current" and any(part.values[3:6])
        if random or part.id in drawn:
            yield "faults"
    if scenario.other_laws:
        yield "perhaps laws of yours"
    if scenario.plants:
        yield "perhaps plants"


def _drawn(c: Condition) -> bool:
    chance = c.jitter_ns or c.loss or c.loss_model is not None or c.duplicate or c.corrupt or c.reorder
    return bool(chance) and c.up
