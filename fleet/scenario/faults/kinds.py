"""All kinds of faults. A new one of ours is a class and one line here; one of an add-on registers itself."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from fleet.addon import parts
from fleet.scenario.faults.kind import FaultKind
from fleet.scenario.faults.of_agents import OF_AGENTS
from fleet.scenario.faults.of_links import OF_LINKS
from fleet.scenario.faults.of_motion import OF_MOTION
from fleet.scenario.faults.of_sensors import OF_SENSORS

_OURS = (*OF_LINKS, *OF_AGENTS, *OF_SENSORS, *OF_MOTION)


def every_kind() -> Mapping[str, FaultKind]:
    """Our kinds and those of add-ons, none of which takes the place of ours."""
    return MappingProxyType(
        {kind.name: kind for kind in _OURS}
        | {kind.name: kind for kind in parts("fault_kinds") if kind.name not in {ours.name for ours in _OURS}}
    )


KINDS = every_kind()
OF_ROBOTS = tuple(name for name, kind in KINDS.items() if kind.acts_on == "network")  # robots of others too
