"""Site files: water as it was at a sea trial, as numbers in TOML with their source and how well they fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fleet import quantities as q
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, out_of_range, table

_PACKAGE = "netem.sites"
NUMBERS: dict[str, q.Dimension] = {"spreading": q.NUMBER, "excess": q.LEVEL, "shadowing": q.LEVEL, "rician": q.NUMBER}
_BOUNDS = {"spreading": (1.0, 3.0), "excess": (-100.0, 200.0), "shadowing": (0.0, 30.0), "rician": (0.0, 1e6)}


@dataclass(frozen=True, slots=True)
class SiteFile:
    """The content of a site file; `netem.modem.AcousticConfig` says what the numbers mean."""

    name: str
    title: str
    fit: str  # how well the numbers fit what was measured
    spreading: float
    excess: float  # dB
    shadowing: float  # dB
    rician: float


def shipped_sites() -> list[str]:
    """The sites that come with the package."""
    return data_files.shipped(_PACKAGE)


def load_site(name: str, folder: Path | None = None) -> SiteFile:
    """A shipped site by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises DataFileError: with every mistake that was found.
    """
    data, path = data_files.find("site", name, _PACKAGE, folder)
    texts = ("name", "title", "fit", "source")
    values, problems = data_files.read("site", data, path, (*texts, "site"))
    problems += [f"{key} is missing" for key in texts if not isinstance(values.get(key), str)]
    numbers = table(values, "site", NUMBERS, problems)
    problems += out_of_range(numbers, NUMBERS, _BOUNDS)
    if problems:
        raise DataFileError("site", path, problems)
    return SiteFile(values["name"], values["title"], values["fit"], **numbers)
