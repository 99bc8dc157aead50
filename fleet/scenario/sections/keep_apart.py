"""The filter that keeps vehicles apart, as its section says."""

from __future__ import annotations

from agents.config import Cylinder, KeepApartParams
from fleet.scenario.schema.keep_apart import KeepApartSection


def keep_apart_params(section: KeepApartSection | None) -> KeepApartParams | None:
    """Its parameters in SI units; None without the section."""
    if section is None:
        return None
    return KeepApartParams(
        distance=section.distance,
        obstacles=tuple(Cylinder(*obstacle.at, obstacle.radius) for obstacle in section.obstacles),
        gain=section.gain,
        lag_s=section.lag / 1e9,
        slew=section.slew,
        acceleration=section.acceleration,
        speed=section.speed,
        climb=section.climb,
        age_cap_s=section.age_cap / 1e9,
    )
