"""Faults of sensors: what a vehicle measures of its own motion."""

from __future__ import annotations

from collections.abc import Sequence
from math import tau
from typing import Annotated, Any, ClassVar, Literal

from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import (
    FaultKind,
    SomeVehicles,
    Strength,
    VehicleFaultKind,
    plane,
)
from fleet.scenario.value_types import Section


class SensorsSection(Section):
    """Standard deviations of white noise on the navigation sensor; 0 is off."""

    position_noise: v.Length = 0.0
    angle_noise: v.Angle = 0.0
    velocity_noise: v.Speed = 0.0
    rate_noise: v.AngularRate = 0.0


class NoiseKeys(SensorsSection):
    vehicles: v.VehicleNumbers | None = None


class NoiseFault(VehicleFaultKind):
    """More noise on the navigation."""

    value = NoiseKeys
    example = "noise vehicles=2 position_noise=10cm"
    every_number_strengthens = True
    drawn = "strength"

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        return {"position_noise": f"{strength.between(0.01, 1.0):g} m"}


class BiasKeys(SomeVehicles):
    position: v.Position = (0.0, 0.0, 0.0)  # NED
    velocity: v.Velocity = (0.0, 0.0, 0.0)  # body
    pitch: v.SignedAngle = 0.0
    yaw: v.SignedAngle = 0.0
    pitch_rate: v.SignedAngularRate = 0.0
    yaw_rate: v.SignedAngularRate = 0.0
    roll: v.SignedAngle = 0.0  # only for vehicles that can roll
    roll_rate: v.SignedAngularRate = 0.0


class BiasFault(VehicleFaultKind):
    """The navigation is off by a constant."""

    value = BiasKeys
    example = "bias vehicles=2 position=1 0 0 m"
    every_number_strengthens = True
    drawn = "strength"

    def numbers(self, values: Any) -> tuple[float, ...]:
        b: BiasKeys = values
        return *b.position, b.pitch, b.yaw, *b.velocity, b.pitch_rate, b.yaw_rate, b.roll, b.roll_rate

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        return {"position": plane(strength.between(0.1, 5.0), tau * strength.turn, " 0 m")}


class FreezeFault(VehicleFaultKind):
    """The same measurement again and again."""

    example = "freeze 3"
    drawn = "target"
    shown = "freeze"
    offers = (("freeze sensors", "freeze {0}"),)


class DropoutKeys(SomeVehicles):
    probability: Annotated[v.Probability, v.loss_once("probability")]


class DropoutFault(VehicleFaultKind):
    """The navigation sensor repeats its last measurement, with this probability at each tick."""

    value = DropoutKeys
    example = "dropout vehicles=2 loss=30%"
    every_number_strengthens = True
    drawn = "strength"

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        return {"loss": f"{strength.between(10, 100):g} %"}


class _OfInstrument(VehicleFaultKind):
    """Samples of one instrument that are lost, biased, or jump."""

    every_number_strengthens = True
    drawn = "strength"
    needs: ClassVar[Literal["", "clock", "dead reckoning", "fixes"]] = "dead reckoning"

    def does_nothing(self, values: Any) -> bool:
        *others, jump, chance = self.numbers(values)
        return not any(others) and not (jump and chance)

    def bias_of_strength(self, strength: Strength, angle: float) -> str:
        raise NotImplementedError

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        if strength.turn < 0.5:
            return {"loss": f"{strength.between(5, 100):g} %"}
        return {"bias": self.bias_of_strength(strength, tau * 2.0 * (strength.turn - 0.5))}


class DvlKeys(SomeVehicles):
    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0  # probability for each sample
    bias: v.Velocity = (0.0, 0.0, 0.0)  # body
    jump: v.Speed = 0.0  # standard deviation on each axis
    chance: v.Probability = 0.1  # probability that a sample jumps


class DvlFault(_OfInstrument):
    """Of the DVL of vehicles that navigate."""

    value = DvlKeys
    example = "dvl vehicles=2 loss=100%"

    def bias_of_strength(self, strength: Strength, angle: float) -> str:
        return plane(strength.between(0.02, 0.5), angle, " 0 m/s")


class CompassKeys(SomeVehicles):
    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0
    bias: v.SignedAngle = 0.0
    jump: v.Angle = 0.0
    chance: v.Probability = 0.1


class CompassFault(_OfInstrument):
    """Of the heading sensor."""

    value = CompassKeys
    example = "compass vehicles=2 bias=10 deg"

    def bias_of_strength(self, strength: Strength, angle: float) -> str:
        return f"{'-' if angle < tau / 2 else ''}{strength.between(1, 30):g} deg"


class FixKeys(SomeVehicles):
    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0
    bias: v.PlanPosition = (0.0, 0.0)  # north, east
    jump: v.Length = 0.0
    chance: v.Probability = 0.1


class FixFault(_OfInstrument):
    """Of the fixes of the position."""

    value = FixKeys
    example = "fix vehicles=2 jump=20 m"
    needs = "fixes"

    def bias_of_strength(self, strength: Strength, angle: float) -> str:
        return plane(strength.between(1.0, 50.0), angle, " m")


OF_SENSORS: Sequence[FaultKind] = (
    NoiseFault(),
    BiasFault(),
    FreezeFault(),
    DropoutFault(),
    DvlFault(),
    CompassFault(),
    FixFault(),
)
