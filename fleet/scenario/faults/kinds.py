"""All kinds of faults. A new one of ours is a class and one line here; one of an add-on registers itself."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

from pydantic import TypeAdapter

from fleet.addon import leave_out, sound_parts
from fleet.scenario.faults.kind import FaultKind
from fleet.scenario.faults.of_agents import OF_AGENTS
from fleet.scenario.faults.of_links import OF_LINKS
from fleet.scenario.faults.of_motion import OF_MOTION
from fleet.scenario.faults.of_sensors import OF_SENSORS

_OURS = (*OF_LINKS, *OF_AGENTS, *OF_SENSORS, *OF_MOTION)


def every_kind() -> Mapping[str, FaultKind]:
    """Our kinds and those of add-ons, none of which takes the place of ours."""
    found = {kind.name: kind for kind in _OURS}
    for kind in sound_parts("fault_kinds", _try):
        if kind.name in found:
            leave_out(f"{type(kind).__module__}.fault_kinds", f"there is a fault {kind.name} already")
        else:
            found[kind.name] = kind
    return MappingProxyType(found)


def _try(kind: FaultKind) -> None:
    """Read everything that others read of a kind. Raises whatever is wrong with it."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,31}", kind.name):
        raise ValueError(f"expected a name of small letters, got {kind.name!r:.40}")
    TypeAdapter(kind.value)
    texts = (kind.example, kind.shown, *(text for offer in kind.offers for text in offer))
    if not all(isinstance(text, str) for text in texts) or kind.acts_on not in ("network", "agent", "vehicle"):
        raise ValueError("example, shown and offers are texts, and it acts on the network, an agent or a vehicle")
    _ = kind.section


KINDS = every_kind()
OF_ROBOTS = tuple(name for name, kind in KINDS.items() if kind.acts_on == "network")  # robots of others too
