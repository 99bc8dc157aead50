"""Faults of what moves a vehicle: its actuators and the sea."""

from __future__ import annotations

from collections.abc import Sequence
from math import tau
from typing import Annotated, Any

from msgspec import structs
from pydantic import PlainSerializer

from fleet.quantities import show_time
from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import (
    FaultKind,
    FleetFaultKind,
    Part,
    SomeVehicles,
    Strength,
    Surroundings,
    VehicleFaultKind,
    plane,
)
from fleet.scenario.value_types import Section, word_for
from netem.wire.messages import TimedFault


class EfficiencyKeys(SomeVehicles):
    surge: v.Ratio = 1.0
    pitch: v.Ratio = 1.0
    yaw: v.Ratio = 1.0


class EfficiencyFault(VehicleFaultKind):
    """The share of each command that the actuators still produce."""

    value = EfficiencyKeys
    example = "efficiency vehicles=2 surge=50%"
    drawn = "strength"
    offers = (("weaken", "efficiency vehicles={0} surge=50%"),)

    def does_nothing(self, values: Any) -> bool:
        return all(number == 1.0 for number in self.numbers(values))

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        left = strength._replace(size=1.0 - strength.size).between(0.1, 0.9)
        return dict.fromkeys(("surge", "pitch", "yaw"), f"{left:g}")


class SaturateKeys(SomeVehicles):
    surge_force: v.Force | None = None
    pitch_moment: v.Moment | None = None
    yaw_moment: v.Moment | None = None


_ANY = 1e300  # N, N m: a limit that nothing reaches


class SaturateFault(VehicleFaultKind):
    """Smaller limits of the actuators."""

    value = SaturateKeys
    example = "saturate vehicles=2 yaw_moment=2 N m"

    def numbers(self, values: Any) -> tuple[float, ...]:
        limits = values.surge_force, values.pitch_moment, values.yaw_moment
        return tuple(_ANY if limit is None else limit for limit in limits)

    def does_nothing(self, values: Any) -> bool:
        return all(number == _ANY for number in self.numbers(values))


class OffFault(VehicleFaultKind):
    """No force, no moments."""

    example = "off 3"
    drawn = "target"


class StuckFault(VehicleFaultKind):
    """The force and moments of the tick at which it began."""

    example = "stuck 3"
    drawn = "target"
    holds_command = True


class CurrentSection(Section):
    """An irrotational current, NED: constant, or with a first-order Gauss-Markov part."""

    mean: v.Velocity = (0.0, 0.0, 0.0)
    sigma: v.Speeds = (0.0, 0.0, 0.0)
    time_constant: v.Period = 60_000_000_000


def _show_current(current: CurrentSection | None) -> Any:
    return current and (current.model_dump() if any(current.sigma) else current.model_dump()["mean"])


CurrentValue = Annotated[CurrentSection, word_for("mean"), PlainSerializer(_show_current)]


class CurrentFault(FleetFaultKind):
    """A current in addition to the sea's own."""

    value = CurrentValue
    one_word = True
    example = "current 0.2 0 0 m/s"
    every_number_strengthens = True
    offers = (("current", "current 0.2 0 0 m/s"),)

    def numbers(self, values: Any) -> tuple[float, ...]:
        return *values.mean, *values.sigma, values.time_constant / 1e9

    def does_nothing(self, values: Any) -> bool:
        return not any((*values.mean, *values.sigma))


class GustKeys(Section):
    velocity: v.Velocity
    over: v.Period


class GustFault(FleetFaultKind):
    """A current that rises to a velocity and falls again."""

    value = GustKeys
    example = "gust velocity=0 0.5 0 m/s over=10s"
    every_number_strengthens = True
    drawn = "strength"
    offers = (("gust", example),)

    def numbers(self, values: Any) -> tuple[float, ...]:
        return *values.velocity, values.over / 1e9

    def does_nothing(self, values: Any) -> bool:
        return not any(values.velocity)

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        over = times.begin + -(-values.over // around.tick_ns)
        end = over if times.end is None else min(times.end, over)
        return super().parts(values, structs.replace(times, end=end), around)

    def of_strength(self, target: str, strength: Strength) -> Any:
        velocity = plane(strength.between(0.1, 1.0), tau * strength.turn, " 0 m/s")
        return {"velocity": velocity, "over": show_time(strength.lasts_ns)}


class WrenchKeys(SomeVehicles):
    force: v.ForceVector = (0.0, 0.0, 0.0)
    pitch_moment: v.AnyMoment = 0.0
    yaw_moment: v.AnyMoment = 0.0


class WrenchFault(VehicleFaultKind):
    """A constant force and moment in body axes."""

    value = WrenchKeys
    example = "wrench vehicles=2 force=1 0 0 N"
    every_number_strengthens = True


OF_MOTION: Sequence[FaultKind] = (
    EfficiencyFault(),
    SaturateFault(),
    OffFault(),
    StuckFault(),
    CurrentFault(),
    GustFault(),
    WrenchFault(),
)
