"""The navigation of the vehicles: grades, which are TOML files of numbers with unit and source, fixes, and traces.

```toml
name = "my-ins"
title = "what it is"
[grade]
heading_bias = { value = 0.5, unit = "deg", source = "data sheet, 2024, p. 2" }
...
```

`world.navigation.config.Grade` says what each number means; `world/navigation` has the shipped files.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from fleet import quantities as q
from fleet.scenario.schema.navigation import DEFAULT_GRADE, ExpectedCurrent, FixSection, NavigationSection
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, Number, range_problems, table
from fleet.scenario.sections.navigation_trace import _content, load_trace
from world.navigation.config import DeadReckoning, FixKind, FixSource, Grade, Navigation, NavigationTrace

_PACKAGE = "world.navigation"
# The ranges are those in which the filter's linear equations hold.
_RATE = Number(q.SAMPLE_RATE, 0.001, 10_000.0)
_ANGLE = Number(q.ANGLE, 0.0, 0.5)
_WALK = Number(q.ANGLE_WALK, 0.0, 0.1)
NUMBERS = {
    "heading_rate": _RATE, "heading_bias": _ANGLE, "heading_noise": _ANGLE, "heading_walk": _WALK,
    "gyro_rate": _RATE, "gyro_bias": Number(q.ANGULAR_RATE, 0.0, 0.1), "gyro_walk": _WALK,
    "dvl_rate": _RATE, "dvl_scale": Number(q.RATIO, 0.0, 0.3), "dvl_noise": Number(q.SPEED, 0.0, 10.0),
    "dvl_altitude": Number(q.LENGTH, 0.0, 1e5),
    "depth_rate": _RATE, "depth_bias": Number(q.LENGTH, 0.0, 1e4), "depth_noise": Number(q.LENGTH, 0.0, 1e4),
    "tilt": _ANGLE,
}  # fmt: skip
DEFAULT_START_M = 1.0
KINDS: tuple[FixKind, ...] = ("gps", "usbl", "lbl")
# Values in place of what a scenario leaves out; docs/guide/navigation.md has their sources.
DEFAULTS: dict[FixKind, dict[str, Any]] = {
    "gps": {"period": 1_000_000_000, "delay": 0, "loss": 0.0, "noise": 2.0, "noise_per_distance": 0.0, "depth": 0.5},
    "usbl": {"period": 5_000_000_000, "delay": 1_000_000_000, "loss": 0.1, "noise": 0.5, "noise_per_distance": 0.01},
    "lbl": {"period": 10_000_000_000, "delay": 1_000_000_000, "loss": 0.1, "noise": 1.0, "noise_per_distance": 0.001},
}
_EVERYWHERE: dict[str, Any] = {"at": (0.0, 0.0, 0.0), "reach": 0.0, "depth": 0.0}


def shipped_grades() -> list[str]:
    """The grades that come with the package."""
    return data_files.shipped_names(_PACKAGE)


def load_grade(name: str, folder: Path | None = None) -> Grade:
    """A shipped grade by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises DataFileError: with every mistake that was found.
    """
    return parse_grade(*data_files.find("grade", name, _PACKAGE, folder))


@lru_cache(64)  # each vehicle of each run of a study reads its grade
def parse_grade(data: bytes, name: str) -> Grade:
    """The grade in the bytes of a file. Raises DataFileError: with every mistake that was found."""
    values, problems = data_files.read("grade", data, name, ("name", "title", "grade"))
    numbers = table(values, "grade", NUMBERS, problems)
    problems += grade_problems(numbers)
    if problems:
        raise DataFileError("grade", name, problems)
    return Grade(**numbers)


def grade_problems(numbers: dict[str, float]) -> list[str]:
    """A line for each number that no instrument can have."""
    return range_problems(numbers, NUMBERS)


def grade_of(section: NavigationSection, folder: Path | None) -> Grade:
    """The numbers of a section: those of its grade, unless the section gives another value. Raises DataFileError."""
    given = {key: getattr(section, key) for key in NUMBERS}
    missing = [key for key, value in given.items() if value is None]
    if not missing:
        return Grade(**given)
    base = load_grade(section.grade or DEFAULT_GRADE, folder)
    return Grade(**given | {key: getattr(base, key) for key in missing})


def navigation_of(section: NavigationSection | None, folder: Path | None) -> Navigation | None:
    """How a vehicle with this section navigates; None: it knows where it is.

    Raises DataFileError: a file is missing or wrong.
    """
    if section is None or section.ideal:
        return None
    if section.trace is not None:
        return NavigationTrace(load_trace(section.trace, folder))
    current = section.current or ExpectedCurrent()
    return DeadReckoning(
        grade=grade_of(section, folder),
        start=DEFAULT_START_M if section.start is None else section.start,
        bottom=section.bottom,
        current_sigma=current.sigma,
        current_time_s=current.time_constant / 1e9,
        fixes=tuple(_source(kind, fixes) for kind in KINDS if (fixes := getattr(section, kind)) is not None),
    )


def _source(kind: FixKind, section: FixSection) -> FixSource:
    of = _EVERYWHERE | DEFAULTS[kind] | {key: value for key, value in section if value is not None}
    return FixSource(
        kind, of["period"], of["delay"], of["loss"], of["noise"], of["noise_per_distance"], of["at"], of["reach"],
        of["depth"],
    )  # fmt: skip


def navigation_over(below: NavigationSection, above: NavigationSection) -> NavigationSection:
    """The navigation of a vehicle that has something of its own (`above`)."""
    if above.ideal or above.trace is not None or below.ideal or below.trace is not None:
        return above
    written = {key: value for key, value in above if key in above.model_fields_set}
    if above.grade is not None:  # the numbers below belong to the grade below
        written = dict.fromkeys(NUMBERS) | written
    return below.model_copy(update=written)


def inlined_navigation(section: NavigationSection | None, folder: Path | None) -> NavigationSection | None:
    """The same section with the content of the user's files in place of their names. Raises DataFileError."""
    if section is None:
        return None
    if section.trace is not None:
        return section.model_copy(update={"trace": _content(section.trace, folder)[0]})
    if section.grade is None or section.grade in shipped_grades():
        return section
    grade = grade_of(section, folder)
    return section.model_copy(update={"grade": DEFAULT_GRADE} | {key: getattr(grade, key) for key in NUMBERS})
