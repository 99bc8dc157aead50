"""Sites: water as it was at a sea trial, as numbers in TOML with their source and how well they fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fleet import quantities as q
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, Number, range_problems, table

_OF_SITES = {
    "spreading": Number(q.NUMBER, 1.0, 3.0),
    "excess": Number(q.LEVEL, -100.0, 200.0),
    "shadowing": Number(q.LEVEL, 0.0, 30.0),
    "rician": Number(q.NUMBER, 0.0, 1e6),
}


@dataclass(frozen=True, slots=True)
class Site:
    """The numbers of a site file; `netem.modem.AcousticConfig` says what they mean."""

    spreading: float
    excess: float  # dB
    shadowing: float  # dB
    rician: float


def load_site(name: str, folder: Path | None = None) -> Site:
    """A shipped site by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises DataFileError: with every mistake that was found.
    """
    data, path = data_files.find("site", name, "netem.sites", folder)
    texts = ("name", "title", "fit", "source")
    values, problems = data_files.read("site", data, path, (*texts, "site"))
    problems += [f"{key} is missing" for key in texts if not isinstance(values.get(key), str)]
    numbers = table(values, "site", _OF_SITES, problems)
    problems += range_problems(numbers, _OF_SITES)
    if problems:
        raise DataFileError("site", path, problems)
    return Site(**numbers)
