"""What can go wrong in the sea; data in fields, so that callers can print their own words."""

from __future__ import annotations


class WorldError(Exception):
    """Base of every error of this package."""


class UnknownVehicleError(WorldError):
    """A vehicle number that the world was not set up with."""

    def __init__(self, vehicle: int, known: tuple[int, ...]) -> None:
        super().__init__(f"vehicle {vehicle} is not in this world, which has {list(known)}")
        self.vehicle = vehicle
        self.known = known


class CommandError(WorldError):
    """A command that no actuator can follow: the wrong number of elements, or one that is not finite."""

    def __init__(self, vehicle: int, tick: int, tau: tuple[float, ...]) -> None:
        super().__init__(f"vehicle {vehicle}, tick {tick}: expected tau as three finite numbers, got {tau!r}")
        self.vehicle = vehicle
        self.tick = tick
        self.tau = tau


class IntegrationError(WorldError):
    """The vehicle's motion cannot be integrated over a tick; the world stays as it was before the tick.

    `vehicle` and `tick` are -1 where the equations are used outside a world.
    """

    def __init__(self, reason: str, theta: float, vehicle: int = -1, tick: int = -1) -> None:
        where = f"vehicle {vehicle}, tick {tick}: " if vehicle >= 0 else ""
        super().__init__(where + reason)
        self.reason = reason
        self.theta = theta
        self.vehicle = vehicle
        self.tick = tick


class NonFiniteStateError(IntegrationError):
    """The integration left the range of finite numbers."""
