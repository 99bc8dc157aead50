"""TOML files of numbers with unit and source (where each comes from): shipped with a package, or the user's."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from importlib import resources
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from fleet import quantities as q
from fleet.errors import FleetError
from netem.curve import Curve
from netem.files import read_file
from netem.limits import DATA_FILE
from netem.parsing import nearest

T = TypeVar("T")


class Number(NamedTuple):
    """A number of a file, and the range [SI units] in which the formulas hold: wider than that of any real thing."""

    dimension: q.Dimension
    low: float = -inf
    high: float = inf


class DataFileError(FleetError):
    """A file of numbers is missing or has errors; `problems` has one line of text for each."""

    def __init__(self, kind: str, name: str, problems: list[str]) -> None:
        super().__init__(f"{kind} {name}: " + "; ".join(problems))
        self.problems = problems


def shipped_names(package: str) -> list[str]:
    """The names, without `.toml`, of the TOML files in a package, sorted."""
    entries = resources.files(package).iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml"))


def find(kind: str, name: str, package: str, folder: Path | None) -> tuple[bytes, str]:
    """Content and path of a file. For a shipped file, `name` has no `.toml`, and the second result is `name`.

    Any other file is searched in `folder`, then in the current directory; `kind` is for the texts of errors.

    Raises DataFileError: there is no such file, it cannot be read, or it is larger than 100 kB.
    """
    known = shipped_names(package)
    if name in known:
        return (resources.files(package) / f"{name}.toml").read_bytes(), name
    if not name.endswith(".toml"):
        hint = nearest(name, known) or "a file ends in .toml"
        raise DataFileError(kind, name, [f"there is no such {kind}; there are {', '.join(known)} ({hint})"])
    return find_beside(kind, name, folder, DATA_FILE.bytes)


def find_beside(kind: str, name: str, folder: Path | None, most: int) -> tuple[bytes, str]:
    """Content and path of a file of the user's, which is searched in `folder`, then in the current directory.

    Raises DataFileError: there is no such file, it cannot be read, or it has more than `most` bytes.
    """
    try:
        return read_beside(kind, name, folder, lambda path: (read_file(path, most), str(path)))
    except (OSError, ValueError) as error:  # ValueError: the name has a null byte
        raise DataFileError(kind, name, [getattr(error, "strerror", None) or str(error)]) from None


def read_beside(
    kind: str, name: str, folder: Path | None, read: Callable[[Path], T], most_shown: int | None = None
) -> T:
    """The result of `read` for a file of the user's. The search goes through `folder`, then the current directory.

    Args:
        read: reads the file at a path. After its FileNotFoundError the next place is tried.
        most_shown: characters of the name in errors; None: all.

    Raises DataFileError: there is no such file.
    """
    places = [folder / name] if folder is not None else []
    for path in [*places, Path(name)]:
        with suppress(FileNotFoundError):
            return read(path)
    looked = ", ".join(str(p.parent) for p in places) or "."
    raise DataFileError(kind, name[:most_shown], [f"there is no such file (looked in {looked})"])


def read(kind: str, data: bytes, name: str, keys: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """The content of a TOML file, which may have these keys, and a line for each unknown key.

    Raises DataFileError: the bytes are not TOML.
    """
    try:
        values = tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or an integer of thousands of digits
        raise DataFileError(kind, name, [f"not TOML: {error}"]) from None
    return values, [f"unknown key {key!r}" for key in values if key not in keys]


def table(
    values: dict[str, Any],
    section: str,
    known: Mapping[str, Number],
    problems: list[str],
    optional: Collection[str] = (),
) -> dict[str, float]:
    """The numbers of a section, in SI units. One with a mistake is left out, and a line about it goes into `problems`.

    `optional`: keys that may be missing; what is in `optional` alone is no number, and is not looked at.
    """
    entries = values.get(section)
    if not isinstance(entries, dict):
        problems.append(f"there is no [{section}]")
        return {}
    for key in [key for key in entries if key not in known and key not in optional]:
        hint = nearest(key, [*known, *optional])
        problems.append(f"unknown {section}.{key}" + (f" ({hint})" if hint else ""))
    numbers = {}
    for key, (dimension, *_) in known.items():
        entry = entries.get(key)
        if entry is None:
            if key not in optional:
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
            numbers[key] = q.scalar(f"{number!r} {unit}", dimension)
        except q.QuantityError as error:
            problems.append(f"{section}.{key}: {error.message}")
    return numbers


def range_problems(numbers: Mapping[str, float], known: Mapping[str, Number]) -> list[str]:
    """A line for each number that is outside its bounds, which belong to the range; all are in SI units."""
    problems = []
    for key, (dimension, low, high) in known.items():
        if key in numbers and not low <= numbers[key] <= high:
            least, most, value = (q.show(number, dimension) for number in (low, high, numbers[key]))
            problems.append(f"{key} must be between {least} and {most}, is {value}")
    return problems


def curves(
    values: dict[str, Any], section: str, known: dict[str, tuple[q.Dimension, q.Dimension]], problems: list[str]
) -> dict[str, Curve]:
    """The curves of a section, whose points are texts such as `12 m 95 %`; each may be missing.

    One with a mistake is left out, and a line about it goes into `problems`.
    """
    found = {}
    entries = values.get(section)
    if not isinstance(entries, dict):
        return {}  # `table` reports it
    for key, (x, y) in known.items():
        entry = entries.get(key)
        if entry is None:
            continue
        example = f"{x.example} {y.example}, ..."
        if not isinstance(entry, dict) or set(entry) != {"value", "source"}:
            problems.append(f'{section}.{key}: expected {{ value = "{example}", source = "..." }}')
        elif not isinstance(entry["source"], str) or not entry["source"].strip():
            problems.append(f"{section}.{key}: say where the points come from")
        else:
            try:
                found[key] = Curve(q.curve(entry["value"], x, y))
            except q.QuantityError as error:
                problems.append(f"{section}.{key}: {error.message}")
    return found
