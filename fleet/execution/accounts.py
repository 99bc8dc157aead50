"""The account of a completed run: every message that one process sent, another received."""

from __future__ import annotations

from typing import Any

from fleet.errors import RunBroken
from fleet.execution.runner import Closing
from netem.clock import Clock


def closing(world: dict[str, Any], network: dict[str, Any], rejected: dict[str, int]) -> Closing:
    """The final reports of a completed run's processes.

    Args:
        world, network: what they answered to `close`.
        rejected: notes that were not kept, by key.
    """
    return Closing(
        entered={(src, dst): (sent, copies) for src, dst, sent, copies in network.get("entered", ())},
        rejected={**world.get("rejected", {}), **network.get("rejected", {}), **rejected},
        timing={**world.get("timing", {}), "netem": network.get("timing", {})},
    )


def lost_messages(counts: dict[str, Any], clock: Clock = Clock.LOCKSTEP) -> int:
    """How many messages left one process of a completed run and never arrived at the other.

    Every nav is answered by one command; agents' own counts are not needed.

    Args:
        counts: by process (`world`, `netem`, `console`), how many messages of each kind it sent and received.
        clock: on a wall clock an agent may skip navs, and commands are not counted.

    Raises:
        RunBroken: a process did not report what it sent and received.
    """
    try:
        world_sent, world_received = counts["world"]["sent"], counts["world"]["received"]
        netem_sent, netem_received = counts["netem"]["sent"], counts["netem"]["received"]
        console = counts["console"]
        pairs = [
            *([(world_sent["nav"], world_received["cmd"])] if clock is Clock.LOCKSTEP else []),
            (world_sent["round"], netem_received["round"]),
            (world_sent["frame"], console["frame"]),
            (netem_sent["links"], console["links"]),
        ]
    except KeyError as error:
        raise RunBroken(f"a process closed without its count of {error}") from None
    return sum(abs(sent - received) for sent, received in pairs)
