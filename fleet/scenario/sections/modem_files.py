"""Modem files: the numbers of an acoustic modem in TOML, each with its unit and its source.

```toml
name = "my-modem"
title = "what it is"
[modem]
bit_rate = { value = 400, unit = "bit/s", source = "data sheet, 2024, p. 2" }
delivery = { value = "12 m 95 %, 24 m 70 %", source = "lake trial, May 2024" }
...
```

`netem.modem.Modem` documents each number; `netem/modems` has the shipped files.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from fleet import quantities as q
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, Number, range_problems, table
from netem.modem import Modem

_PACKAGE = "netem.modems"
NUMBERS = {
    "bit_rate": Number(q.BIT_RATE, 0.1, 1e8),
    "preamble": Number(q.TIME, 0.0, 3600.0),
    "carrier": Number(q.FREQUENCY, 100.0, 1e6),
    "bandwidth": Number(q.FREQUENCY, 1.0, 1e6),
    "source_level": Number(q.LEVEL, 0.0, 300.0),
    "directivity": Number(q.LEVEL, -100.0, 100.0),
    "max_range": Number(q.LENGTH, 1.0, 1e7),
    "interference_range": Number(q.LENGTH, 0.0, 1e7),
    "mtu": Number(q.SIZE, 1.0, 1e6),
    "lost_below": Number(q.LEVEL, -200.0, 200.0),
    "clear_above": Number(q.LEVEL, -200.0, 200.0),
    "capture": Number(q.LEVEL, 0.0, 200.0),
    "processing": Number(q.TIME, 0.0, 3600.0),
    "tries": Number(q.NUMBER, 0.0, 100.0),
    "timeout": Number(q.TIME, 0.0, 3600.0),
    "acknowledgement": Number(q.SIZE, 0.0, 1e6),
}
# What was measured at some points. A curve of airtimes takes the place of two numbers, one of deliveries of two others.
CURVES: dict[str, tuple[q.Dimension, q.Dimension]] = {
    "airtime": (q.SIZE, q.TIME),
    "delivery": (q.LENGTH, q.RATIO),
    "captured": (q.LEVEL, q.RATIO),
}
_IN_PLACE = {"airtime": ("bit_rate", "preamble"), "delivery": ("lost_below", "clear_above")}
_LEFT_OUT: dict[str, float] = {"processing": 0.0, "tries": 0, "timeout": 0.0, "acknowledgement": 0}
WHOLE = ("mtu", "tries", "acknowledgement")
_OF = {"mtu": " of bytes", "acknowledgement": " of bytes"}
Values = dict[str, Any]  # what a modem file says: numbers, and curves or None


def shipped_modems() -> list[str]:
    """The modems that come with the package."""
    return data_files.shipped_names(_PACKAGE)


def load_modem(name: str, folder: Path | None = None) -> Modem:
    """A shipped modem by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises DataFileError: with every mistake that was found.
    """
    return parse_modem(*data_files.find("modem", name, _PACKAGE, folder))


@lru_cache(64)  # each run of a study reads its modem
def parse_modem(data: bytes, name: str) -> Modem:
    """The modem in the bytes of a file. Raises DataFileError: with every mistake that was found."""
    values, problems = data_files.read("modem", data, name, ("name", "title", "modem"))
    curves = data_files.curves(values, "modem", CURVES, problems)
    replaced = {key: 0.0 for curve in curves for key in _IN_PLACE.get(curve, ())}
    numbers = table(values, "modem", NUMBERS, problems, {*CURVES, *_LEFT_OUT, *replaced})
    given = values.get("modem")
    if isinstance(given, dict):
        problems += [
            f"modem.{key} has no effect beside a curve that takes its place" for key in replaced if key in given
        ]
    found = replaced | _LEFT_OUT | numbers | dict.fromkeys(CURVES) | curves
    problems = problems or modem_problems(found)
    if problems:
        raise DataFileError("modem", name, problems)
    return modem_of(found)


def merge_values(values: Values, changes: Values) -> Values:
    """The values of a modem with some that differ; a line in place of a curve removes the curve, and the other way."""
    gone: Values = {}
    for curve, line in _IN_PLACE.items():
        if changes.get(curve) is not None:
            gone |= dict.fromkeys(line, 0.0)
        elif any(key in changes for key in line):
            gone[curve] = None
    return values | gone | changes


def without_replaced(values: Values) -> Values:
    """The values that count: without curves that are not there, and without what a curve takes the place of."""
    replaced = {key for curve, keys in _IN_PLACE.items() if values[curve] is not None for key in keys}
    return {key: value for key, value in values.items() if value is not None and key not in replaced}


def modem_of(values: Values) -> Modem:
    """The modem with these values."""
    return Modem(**values | {key: int(values[key]) for key in WHOLE})


def modem_problems(values: Values) -> list[str]:
    """A line for each value that no modem can have."""
    problems = range_problems(without_replaced(values), NUMBERS)
    problems += [
        f"{key} must be a whole number{_OF.get(key, '')}, is {values[key]:g}" for key in WHOLE if values[key] % 1
    ]
    if values["lost_below"] > values["clear_above"]:
        problems.append(f"lost_below {values['lost_below']:g} dB is above clear_above {values['clear_above']:g} dB")
    if values["tries"] and not values["timeout"]:
        problems.append("tries needs a timeout: how long the modem waits for an acknowledgement")
    airtime = values["airtime"]
    if airtime is not None:
        last = airtime.points[-1][0]
        if last < values["mtu"]:
            problems.append(f"airtime ends at {last:g} bytes, before the mtu of {values['mtu']:g} bytes")
        if any(y1 < y0 for (_, y0), (_, y1) in pairwise(airtime.points)):
            problems.append("airtime must not fall: a longer payload is not shorter on the air")
    shares = {key: values[key].points for key in ("delivery", "captured") if values[key] is not None}
    problems += [
        f"{key} must be between 0 and 100 %"
        for key, points in shares.items()
        if not all(0.0 <= share <= 1.0 for _, share in points)
    ]
    return problems
