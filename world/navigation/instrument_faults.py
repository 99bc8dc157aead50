"""Faults of instruments and fixes: samples that are lost, biased, or jump."""

from __future__ import annotations

from netem.draws import normal, undecided, uniform
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import WorldFault

KINDS = (WorldFaultKind.DVL, WorldFaultKind.COMPASS, WorldFaultKind.FIX)


def lost(fault: WorldFault, seed: int, i: int, tick: int, source: int = 0) -> bool:
    """Whether a fault takes the sample of a tick; the probability is the first of its numbers."""
    chance = fault.values[0]
    return chance >= 1.0 or (chance > 0.0 and uniform(seed, _purpose(fault, "lost"), i, tick, source) < chance)


def jumps(fault: WorldFault, seed: int, i: int, tick: int, axes: int, source: int = 0) -> list[float]:
    """How far off a fault puts the sample of a tick on each axis; its last two numbers are sigma and probability."""
    sigma, chance = fault.values[-2:]
    if sigma == 0.0 or (chance < 1.0 and uniform(seed, _purpose(fault, "jumps"), i, tick, source) >= chance):
        return [0.0] * axes
    return [sigma * normal(seed, _purpose(fault, "jump"), i, tick, source, axis) for axis in range(axes)]


def draws(fault: WorldFault) -> list[str]:
    """The purposes of the draws that decide what such a fault does; none of other faults."""
    if fault.kind not in KINDS:
        return []
    found = [_purpose(fault, "lost")] if undecided(fault.values[0]) else []
    sigma, chance = fault.values[-2:]
    if sigma > 0.0 and chance > 0.0:
        found += [_purpose(fault, "jumps")] if undecided(chance) else []
        found.append(_purpose(fault, "jump"))
    return found


def _purpose(fault: WorldFault, what: str) -> str:
    return f"fault {fault.id} {what}"
