"""Faults of agents: of their lives, their messages, and their clocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fleet.quantities import show_time
from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import (
    FaultKind,
    Kill,
    Part,
    SomeVehicles,
    Strength,
    Surroundings,
    VehicleFaultKind,
    network_fault,
    world_fault,
)
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import TimedFault


class KillFault(VehicleFaultKind):
    """The agent ends; the vehicle drifts until it is restarted."""

    example = "kill 3"
    acts_on = "agent"
    drawn = "target"
    silences = True
    shown = "no agent"
    offers = (("kill", "kill {0}"),)

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        end = times.end
        if end is not None:
            # An agent begins again with a round: only then do agents send, and the network counts their messages.
            end = -(-end // around.round_ticks) * around.round_ticks
            end = end if end < around.ticks else None
        return [Kill(times.id, times.begin, end, self.vehicles(values))]


class PauseFault(VehicleFaultKind):
    """The agent is suspended; the vehicle holds its last command."""

    example = "pause 3"
    acts_on = "agent"
    drawn = "target"
    silences = holds_command = True
    shown = "no agent"
    offers = (("pause", "pause {0}"),)


class _OfMessages(VehicleFaultKind):
    acts_on = "network"
    drawn = "target"

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        return [network_fault(times, self.name, vehicles=self.vehicles(values))]


class MuteFault(_OfMessages):
    """It sends nothing."""

    example = "mute 3"
    silences = True
    shown = "mute"
    offers = (("mute", "mute {0}"),)


class DeafFault(_OfMessages):
    """It receives nothing."""

    example = "deaf 3"
    offers = (("deaf", "deaf {0}"),)


class SlowKeys(SomeVehicles):
    by: v.Ticks


class SlowFault(VehicleFaultKind):
    """The commands and the messages of an agent are late."""

    value = SlowKeys
    example = "slow vehicles=2 by=5 ticks"
    acts_on = "agent"
    every_number_strengthens = True
    drawn = "strength"

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        who = self.vehicles(values)
        everyone = who or tuple(range(1, around.vehicles + 1))
        return [
            network_fault(times, "slow", vehicles=everyone, ticks=values.by),
            world_fault(times, WorldFaultKind.SLOW, who, (float(values.by),)),
        ]

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        most = max(2, 5 * strength.round_ns // strength.tick_ns)
        return {"by": f"{round(strength.between(1, most))} ticks"}


class ClockKeys(SomeVehicles):
    step: v.ClockTime = 0
    drift: v.ClockDrift = 0.0


class ClockFault(VehicleFaultKind):
    """A clock, of the agent and its modem, is set to another time, and goes faster or slower. At the end the step is
    undone."""

    value = ClockKeys
    example = "clock vehicles=2 step=200ms"
    every_number_strengthens = True
    drawn = "strength"
    needs = "clock"

    def numbers(self, values: Any) -> tuple[float, ...]:
        return values.step / 1e9, values.drift

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        who, numbers = self.vehicles(values), self.numbers(values)
        return [
            network_fault(times, "clock", vehicles=who, values=numbers),
            world_fault(times, WorldFaultKind.CLOCK, who, numbers),
        ]

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        sign, step = "-" if strength.turn < 0.5 else "", show_time(round(strength.between(1e6, 1e9)))
        return {"step": f"{sign}{step}", "drift": f"{sign}{strength.between(20, 20_000):g} ppm"}


OF_AGENTS: Sequence[FaultKind] = (KillFault(), PauseFault(), MuteFault(), DeafFault(), SlowFault(), ClockFault())
