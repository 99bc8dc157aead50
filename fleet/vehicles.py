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

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from fleet import quantities as q
from fleet.errors import FleetError
from netem.grammar import nearest
from world.vehicle import Vec3, VehicleParams

PARAMETERS: dict[str, q.Dimension] = {
    "m": q.MASS, "Iy": q.INERTIA, "Iz": q.INERTIA,
    "beta_udot": q.MASS, "beta_vdot": q.MASS, "beta_wdot": q.MASS,
    "beta_qdot": q.INERTIA, "beta_rdot": q.INERTIA,
    "beta_u": q.DAMPING, "beta_v": q.DAMPING, "beta_w": q.DAMPING,
    "beta_q": q.ROTATION_DAMPING, "beta_r": q.ROTATION_DAMPING, "beta_b": q.MOMENT,
}  # fmt: skip
LIMITS: dict[str, q.Dimension] = {"surge_force": q.FORCE, "pitch_moment": q.MOMENT, "yaw_moment": q.MOMENT}
# As in the schema: the merged scenario holds the numbers of a file as keys.
NOT_NEGATIVE = frozenset(LIMITS) | {key for key, d in PARAMETERS.items() if d in (q.DAMPING, q.ROTATION_DAMPING)}
_MAX_BYTES = 100_000


class VehicleFileError(FleetError):
    """A vehicle file that is not there or not right; `problems` holds one line per mistake."""

    def __init__(self, name: str, problems: list[str]) -> None:
        super().__init__(f"vehicle {name}: " + "; ".join(problems))
        self.problems = problems


@dataclass(frozen=True, slots=True)
class Vehicle:
    """The numbers of a vehicle file, in SI units."""

    name: str
    params: VehicleParams
    tau_max: Vec3  # N, N m, N m
    shipped: bool


def shipped() -> list[str]:
    """The vehicles that come with the package."""
    folder = resources.files("world.vehicles")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_vehicle(name: str, folder: Path | None = None) -> Vehicle:
    """A shipped vehicle by name, or a file, looked for in `folder` (the scenario's) and then where we are.

    Raises:
        VehicleFileError: with every mistake that was found.
    """
    if name in shipped():
        return _shipped(name)
    if not name.endswith(".toml"):
        hint = nearest(name, shipped()) or "a file ends in .toml"
        raise VehicleFileError(name, [f"there is no such vehicle; there are {', '.join(shipped())} ({hint})"])
    places = [folder / name] if folder is not None else []
    for path in [*places, Path(name)]:
        try:
            with path.open("rb") as file:
                return parse_vehicle(file.read(_MAX_BYTES), str(path))
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:  # ValueError: no name of a file
            raise VehicleFileError(name, [getattr(error, "strerror", None) or str(error)]) from None
    raise VehicleFileError(
        name, [f"there is no such file (looked in {', '.join(str(p.parent) for p in places) or '.'})"]
    )


@cache
def _shipped(name: str) -> Vehicle:
    data = (resources.files("world.vehicles") / f"{name}.toml").read_bytes()
    return parse_vehicle(data, name, shipped=True)


def parse_vehicle(data: bytes, name: str, *, shipped: bool = False) -> Vehicle:
    """The vehicle in the bytes of a file.

    Raises:
        VehicleFileError: with every mistake that was found.
    """
    try:
        values = tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or an integer of thousands of digits
        raise VehicleFileError(name, [f"not TOML: {error}"]) from None
    problems = [f"unknown key {key!r}" for key in values if key not in ("name", "title", "parameters", "limits")]
    params = _table(values, "parameters", PARAMETERS, problems)
    limits = _table(values, "limits", LIMITS, problems)
    for section, table in (("parameters", params), ("limits", limits)):
        problems += [f"{section}.{key} must be 0 or more" for key in table if key in NOT_NEGATIVE and table[key] < 0.0]
    if not problems:
        problems += mass_problems(VehicleParams(**params))
    if problems:
        raise VehicleFileError(name, problems)
    return Vehicle(
        str(values.get("name", name)),
        VehicleParams(**params),
        (limits["surge_force"], limits["pitch_moment"], limits["yaw_moment"]),
        shipped,
    )


def mass_problems(params: VehicleParams) -> list[str]:
    """What makes the equations of motion unsolvable: an inertia that is not positive."""
    names = ("m - beta_udot", "m - beta_vdot", "m - beta_wdot", "Iy - beta_qdot", "Iz - beta_rdot")
    return [f"{name} must be above 0, is {m:g}" for name, m in zip(names, params.inertia, strict=True) if m <= 0.0]


def _table(
    values: dict[str, Any], section: str, known: dict[str, q.Dimension], problems: list[str]
) -> dict[str, float]:
    table = values.get(section)
    if not isinstance(table, dict):
        problems.append(f"there is no [{section}]")
        return {}
    for key in [key for key in table if key not in known]:
        hint = nearest(key, known)
        problems.append(f"unknown {section}.{key}" + (f" ({hint})" if hint else ""))
    found = {}
    for key, dimension in known.items():
        entry = table.get(key)
        if entry is None:
            problems.append(f"{section}.{key} is missing")
            continue
        if not isinstance(entry, dict) or set(entry) != {"value", "unit", "source"}:
            problems.append(f'{section}.{key}: expected {{ value = 1.0, unit = "...", source = "..." }}')
            continue
        number, unit, source = entry["value"], entry["unit"], entry["source"]
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not isinstance(unit, str):
            problems.append(f"{section}.{key}: expected a number and a unit as text")
            continue
        if not isinstance(source, str) or not source.strip():
            problems.append(f"{section}.{key}: say where the number comes from")
            continue
        try:
            found[key] = q.scalar(f"{number!r} {unit}", dimension)
        except q.QuantityError as error:
            problems.append(f"{section}.{key}: {error.message}")
    return found
