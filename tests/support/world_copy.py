"""A second world that goes on where a first one is, through MessagePack."""

from __future__ import annotations

from typing import Any

import msgpack
import msgspec

from netem.wire.messages import WorldFault
from world.sea import World


def state_values(world: World) -> dict[str, Any]:
    """Everything that changes in a world, as plain MessagePack values."""
    return {"vehicles": [[i, world.memory(i)] for i in world.ids], "faults": msgspec.to_builtins(world.faults)}


def restore(world: World, values: dict[str, Any]) -> None:
    """Continue from `state_values` of a world with the same configuration."""
    for i, memory in values["vehicles"]:
        world.remember(i, memory)
    world.faults = msgspec.convert(values["faults"], tuple[WorldFault, ...])


def copy_state(source: World, target: World) -> None:
    """Let `target` continue where `source` is."""
    restore(target, msgpack.unpackb(msgpack.packb(state_values(source))))
