"""How everybody kept up in a run on a wall clock, as the world and the network measure it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from netem.clock import Clock
from netem.ledger import Count

Counts = dict[str, Count]  # by vehicle
Bucket = tuple[Annotated[float, Meta(gt=0, le=1e15)], Count]


class Spread(Struct):
    """The distribution of a time."""

    count: Count
    negative: Count
    p50_ms: float
    p95_ms: float
    p99_ms: Annotated[float, Meta(description="99th percentile.")]
    max_ms: float
    histogram_ms: Annotated[list[Bucket], Meta(description="Upper edge and count of each bucket [ms].")]


class WorldTiming(Struct):
    """How the world kept to the wall clock."""

    period_ms: Annotated[float, Meta(description="Of a tick [ms].", gt=0, le=1e9)]
    run_s: Annotated[float, Meta(description="Wall time of the ticks that began.")]
    held_s: float
    slipped_s: Annotated[float, Meta(description="How far the world, being late, moved the clock.")]
    lag: Spread
    gap: Spread


class VehicleTiming(Struct):
    """How one agent kept up."""

    asked: Annotated[Count, Meta(description="Ticks that needed an answer.")]
    missed: Count
    late: Count
    stale: Annotated[Count, Meta(description="With a command of an earlier tick.")]
    longest: Annotated[Count, Meta(description="Longest run of missed ticks.")]
    silent: Annotated[Count, Meta(description="Ticks on which the agent counted as silent.")]
    response: Spread
    gap: Spread

    @property
    def missed_share(self) -> float:
        """The share of its ticks that it missed."""
        return self.missed / max(1, self.asked)


class LinkTiming(Struct):
    """The delay of one directed link."""

    injected: Spread
    measured: Spread


class NetworkTiming(Struct):
    """How the network kept to the wall clock."""

    links: dict[str, LinkTiming]
    hop: Spread
    margin: Annotated[Spread, Meta(description="From the arrival to its due tick; below 0: too late.")]
    overdue: Annotated[Count, Meta(description="Used after their due tick.")]
    unread: Annotated[Count, Meta(description="Not confirmed by an agent at the end.")]
    late: Annotated[Counts, Meta(description="By vehicle.")]
    missed: Annotated[Counts, Meta(description="By vehicle.")]


class Timing(Struct, kw_only=True):
    """How everybody kept up with `--clock real`."""

    clock: Clock = Clock.REAL
    speed: Annotated[float, Meta(description="Times real time [1].")] = 1.0
    label: Annotated[str, Meta(description="on time, or degraded.")] = ""
    reasons: list[str] = []
    world: WorldTiming
    vehicles: dict[str, VehicleTiming]
    netem: NetworkTiming


class Punctual(Struct):
    """How a network of nodes kept to the wall clock."""

    late: Annotated[Spread, Meta(description="How much later than due messages were handed over.")]
    came: Annotated[Spread, Meta(description="How long what came waited for the relay, by probes.")]
    programs: Annotated[
        dict[str, Spread],
        Meta(description="By node: how long a thread of its programs waited for a processor, in each 50 ms."),
    ] = {}
