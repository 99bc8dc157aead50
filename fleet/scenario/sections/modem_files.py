"""Modem files: the numbers of an acoustic modem in TOML, each with its unit and its source.

```toml
name = "my-modem"
title = "what it is"
[modem]
bit_rate = { value = 400, unit = "bit/s", source = "data sheet, 2024, p. 2" }
...
```

`netem.modem.Modem` documents each number; `netem/modems` has the shipped files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fleet import quantities as q
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, table
from netem.modem import Modem

_PACKAGE = "netem.modems"
NUMBERS: dict[str, q.Dimension] = {
    "bit_rate": q.BIT_RATE,
    "preamble": q.TIME,
    "carrier": q.FREQUENCY,
    "bandwidth": q.FREQUENCY,
    "source_level": q.LEVEL,
    "directivity": q.LEVEL,
    "max_range": q.LENGTH,
    "interference_range": q.LENGTH,
    "mtu": q.SIZE,
    "lost_below": q.LEVEL,
    "clear_above": q.LEVEL,
    "capture": q.LEVEL,
}
# The ranges in which the formulas hold; wider than those of any real modem.
BOUNDS: dict[str, tuple[float, float]] = {
    "bit_rate": (0.1, 1e8),
    "preamble": (0.0, 3600.0),
    "carrier": (100.0, 1e6),
    "bandwidth": (1.0, 1e6),
    "source_level": (0.0, 300.0),
    "directivity": (-100.0, 100.0),
    "max_range": (1.0, 1e7),
    "interference_range": (0.0, 1e7),
    "mtu": (1.0, 1e6),
    "lost_below": (-200.0, 200.0),
    "clear_above": (-200.0, 200.0),
    "capture": (0.0, 200.0),
}


@dataclass(frozen=True, slots=True)
class ModemFile:
    """The content of a modem file."""

    name: str
    title: str
    modem: Modem


def shipped_modems() -> list[str]:
    """The modems that come with the package."""
    return data_files.shipped(_PACKAGE)


def load_modem(name: str, folder: Path | None = None) -> ModemFile:
    """A shipped modem by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises:
        DataFileError: with every mistake that was found.
    """
    return parse_modem(*data_files.find("modem", name, _PACKAGE, folder))


def parse_modem(data: bytes, name: str) -> ModemFile:
    """The modem in the bytes of a file.

    Raises:
        DataFileError: with every mistake that was found.
    """
    values = data_files.read("modem", data, name)
    problems = [f"unknown key {key!r}" for key in values if key not in ("name", "title", "modem")]
    numbers = table(values, "modem", NUMBERS, problems)
    problems = problems or modem_problems(numbers)
    if problems:
        raise DataFileError("modem", name, problems)
    return ModemFile(str(values.get("name", name)), str(values.get("title", "")), modem_of(numbers))


def modem_of(numbers: Mapping[str, float]) -> Modem:
    """The modem with these numbers."""
    return Modem(**dict(numbers) | {"mtu": int(numbers["mtu"])})  # type: ignore[arg-type]


def modem_problems(numbers: Mapping[str, float]) -> list[str]:
    """A line for each number that no modem can have."""
    problems = []
    for key, (low, high) in BOUNDS.items():
        if not low <= numbers[key] <= high:
            unit = next(unit for unit, size in NUMBERS[key].units.items() if size == 1)
            problems.append(f"{key} must be between {low:g} and {high:g} {unit}, is {numbers[key]:g}")
    if numbers["mtu"] != int(numbers["mtu"]):
        problems.append(f"mtu must be a whole number of bytes, is {numbers['mtu']:g}")
    if numbers["lost_below"] > numbers["clear_above"]:
        problems.append(f"lost_below {numbers['lost_below']:g} dB is above clear_above {numbers['clear_above']:g} dB")
    return problems
