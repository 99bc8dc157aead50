"""The configuration of netem: the directed links and the condition of each at the start of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from netem.condition import Condition, Link
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace
from netem.lives import Absence
from netem.modem import AcousticConfig
from netem.vehicle_clock import VehicleClock

if TYPE_CHECKING:
    from netem.faults import NetFault


@dataclass(frozen=True, slots=True)
class NetemConfig:
    seed: int
    tick_ns: int
    round_ticks: int
    vehicles: tuple[int, ...]
    links: tuple[Link, ...]  # (j, i): j's payloads reach i, i.e. a_ij > 0
    conditions: dict[Link, Condition] = field(default_factory=dict)
    faults: tuple[NetFault, ...] = ()  # faults in the order in which they begin
    absences: tuple[Absence, ...] = ()  # when a vehicle has no agent: restarts count incarnations
    ideal: bool = False  # zero latency: due in the sending tick itself (in-process only)
    acoustic: AcousticConfig | None = None  # the channel in the water; None: each link is on its own
    changing: dict[Link, LinkStates | LinkTrace] = field(default_factory=dict)  # conditions that change by themselves
    clocks: dict[int, VehicleClock] = field(default_factory=dict)  # clocks of the vehicles for which one is set
    radios: dict[int, Condition] = field(default_factory=dict)  # rate and limit of all that a vehicle sends
