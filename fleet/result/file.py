"""`result.json`. A run writes it; whoever reads it checks all of it, since the file may come from a stranger."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path

import msgspec

from fleet.errors import FleetError
from fleet.result.json_text import json_text
from fleet.result.result import FORMAT, Result
from netem.files import read_file
from netem.limits import RESULT_FILE

RESULT = "result.json"  # in the directory of a run


class ResultError(FleetError):
    """There is a result, and it cannot be used."""


def write_result(result: Result, directory: Path) -> None:
    """Write the result of a run into its directory. Raises OSError: that is not possible."""
    (directory / RESULT).write_text(json_text(result.values) + "\n", "utf-8")


def read_result(directory: Path) -> Result:
    """The result of the run in a directory. Fields that a file of an earlier version lacks have their defaults. Raises
    FileNotFoundError if there is none; ResultError if it is damaged, or of a later version: its text says what is
    wrong, and where.
    """
    path = directory / RESULT
    try:
        data = read_file(path, RESULT_FILE.bytes)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ResultError(f"{path} cannot be read: {error.strerror}") from None
    try:
        # JSON has no word for what is not finite; Python's writer, which earlier versions used, has.
        values = json.loads(data, parse_constant=lambda _: None, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{path} is damaged: not JSON ({error!s:.100})") from None
    if isinstance(values, dict):
        number = values.get("format", FORMAT)
        if isinstance(number, int) and number > FORMAT:
            raise ResultError(f"{path} has format {number}, of a later version of uuv-fleet; this one reads {FORMAT}")
        values |= {"run": directory.name, "directory": None}
    try:
        # Through JSON again, so that no text has what cannot be written, a lone half of a character.
        result = msgspec.json.decode(msgspec.json.encode(values), type=Result)
    except (ValueError, OverflowError, RecursionError) as error:  # msgspec's own are ValueErrors
        raise ResultError(f"{path} is damaged: {error!s:.200}") from None
    result.directory = directory
    return result


def _finite(text: str) -> float | None:
    return value if isfinite(value := float(text)) else None
