"""Vehicle files: the numbers of a vehicle in TOML, each with its unit and its source, so another one needs no code.

```toml
name = "my-glider"
[parameters]
m = { value = 52.0, unit = "kg", source = "Smith et al. 2001, Table 2" }
...
[limits]
surge_force = { value = 12.0, unit = "N", source = "thruster data sheet" }
```
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from fleet import quantities as q
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, Number, table
from world.vectors import Vec3
from world.vehicle_params import VehicleParams

_PACKAGE = "world.vehicles"
_DIMENSIONS = {
    "m": q.MASS, "Iy": q.INERTIA, "Iz": q.INERTIA,
    "beta_udot": q.MASS, "beta_vdot": q.MASS, "beta_wdot": q.MASS,
    "beta_qdot": q.INERTIA, "beta_rdot": q.INERTIA,
    "beta_u": q.DAMPING, "beta_v": q.DAMPING, "beta_w": q.DAMPING,
    "beta_q": q.ROTATION_DAMPING, "beta_r": q.ROTATION_DAMPING, "beta_b": q.MOMENT,
}  # fmt: skip
PARAMETERS = {key: Number(dimension) for key, dimension in _DIMENSIONS.items()}
LIMITS = {"surge_force": Number(q.FORCE), "pitch_moment": Number(q.MOMENT), "yaw_moment": Number(q.MOMENT)}
# As in the schema: the merged scenario holds the numbers of a file as keys.
NOT_NEGATIVE = frozenset(LIMITS) | {key for key, d in _DIMENSIONS.items() if d in (q.DAMPING, q.ROTATION_DAMPING)}


class VehicleModel(NamedTuple):
    """The numbers of a vehicle file, in SI units."""

    params: VehicleParams
    tau_max: Vec3  # N, N m, N m


def shipped_vehicles() -> list[str]:
    """The vehicles that come with the package."""
    return data_files.shipped_names(_PACKAGE)


def load_vehicle(name: str, folder: Path | None = None) -> VehicleModel:
    """A shipped vehicle by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises DataFileError: with every mistake that was found.
    """
    return parse_vehicle(*data_files.find("vehicle", name, _PACKAGE, folder))


@lru_cache
def parse_vehicle(data: bytes, name: str) -> VehicleModel:
    """The vehicle in the bytes of a file. Raises DataFileError: with every mistake that was found."""
    values, problems = data_files.read("vehicle", data, name, ("name", "title", "parameters", "limits"))
    params = table(values, "parameters", PARAMETERS, problems)
    limits = table(values, "limits", LIMITS, problems)
    for section, numbers in (("parameters", params), ("limits", limits)):
        negative = [key for key in numbers if key in NOT_NEGATIVE and numbers[key] < 0.0]
        problems += [f"{section}.{key} must be 0 or more" for key in negative]
    if not problems:
        problems += mass_problems(VehicleParams(**params))
    if problems:
        raise DataFileError("vehicle", name, problems)
    tau_max = limits["surge_force"], limits["pitch_moment"], limits["yaw_moment"]
    return VehicleModel(VehicleParams(**params), tau_max)


def mass_problems(params: VehicleParams) -> list[str]:
    """A line for each inertia that is not positive. The equations of motion cannot be solved with it."""
    names = ("m - beta_udot", "m - beta_vdot", "m - beta_wdot", "Iy - beta_qdot", "Iz - beta_rdot")
    return [f"{name} must be above 0, is {m:g}" for name, m in zip(names, params.inertia, strict=True) if m <= 0.0]
