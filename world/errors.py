"""The errors of this package; what they are about is in fields, so that callers can word their own messages."""

from __future__ import annotations


class WorldError(Exception):
    """Base of every error of this package."""


class IntegrationError(WorldError):
    """The vehicle's motion cannot be integrated over a tick; the world stays as it was before the tick. `vehicle` and
    `tick` are -1 where the equations are used outside a world.
    """

    def __init__(self, reason: str, theta: float, vehicle: int = -1, tick: int = -1) -> None:
        where = f"vehicle {vehicle}, tick {tick}: " if vehicle >= 0 else ""
        super().__init__(where + reason)
        self.reason = reason
        self.theta = theta
        self.vehicle = vehicle
        self.tick = tick


class PlantError(IntegrationError):
    """A plant failed: it raised, took too long, or returned what is no motion. `where` is a line of its code, or ""."""

    def __init__(self, vehicle: int, tick: int, problem: str, where: str) -> None:
        super().__init__(f"{problem} ({where})" if where else problem, 0.0, vehicle, tick)
        self.problem = problem
        self.where = where


class PluginError(WorldError):
    """Code of the user, such as a law, cannot be used: it does not exist, or lacks what its kind must have."""

    def __init__(self, kind: str, name: str, problem: str, hint: str = "") -> None:
        super().__init__(f"{kind} {name!r}: {problem}" + (f"; {hint}" if hint else ""))
        self.kind = kind
        self.name = name
        self.problem = problem
        self.hint = hint


class UntrustedError(PluginError):
    """The module exists and may not run: it is not installed, and the user has not allowed it."""


class FmuError(WorldError):
    """A unit of FMI (an FMU) cannot be used, or failed while it ran."""

    def __init__(self, problem: str, hint: str = "") -> None:
        super().__init__(problem + (f"; {hint}" if hint else ""))
        self.problem = problem
        self.hint = hint
