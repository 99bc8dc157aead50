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

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleet import quantities as q
from fleet.scenario.schema.navigation import DEFAULT_GRADE, ExpectedCurrent, FixSection, NavigationSection
from fleet.scenario.sections import data_files
from fleet.scenario.sections.data_files import DataFileError, out_of_range, table
from fleet.scenario.sections.navigation_trace import load_trace, trace_text
from world.navigation.config import DeadReckoning, FixKind, FixSource, Grade, Navigation, NavigationTrace

_PACKAGE = "world.navigation"
NUMBERS: dict[str, q.Dimension] = {
    "heading_rate": q.SAMPLE_RATE, "heading_bias": q.ANGLE, "heading_noise": q.ANGLE, "heading_walk": q.ANGLE_WALK,
    "gyro_rate": q.SAMPLE_RATE, "gyro_bias": q.ANGULAR_RATE, "gyro_walk": q.ANGLE_WALK,
    "dvl_rate": q.SAMPLE_RATE, "dvl_scale": q.RATIO, "dvl_noise": q.SPEED, "dvl_altitude": q.LENGTH,
    "depth_rate": q.SAMPLE_RATE, "depth_bias": q.LENGTH, "depth_noise": q.LENGTH,
    "tilt": q.ANGLE,
}  # fmt: skip
# The ranges in which the filter's linear equations hold; wider than those of any real instrument.
_BOUNDS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("heading_rate", "gyro_rate", "dvl_rate", "depth_rate"), (0.001, 10_000.0)),
    **dict.fromkeys(("heading_bias", "heading_noise", "tilt"), (0.0, 0.5)),
    **dict.fromkeys(("heading_walk", "gyro_bias", "gyro_walk"), (0.0, 0.1)),
    "dvl_scale": (0.0, 0.3), "dvl_noise": (0.0, 10.0), "dvl_altitude": (0.0, 1e5),
    "depth_bias": (0.0, 1e4), "depth_noise": (0.0, 1e4),
}  # fmt: skip
DEFAULT_START_M = 1.0
KINDS: tuple[FixKind, ...] = ("gps", "usbl", "lbl")
# Values in place of what a scenario leaves out; docs/guide/navigation.md has their sources.
DEFAULTS: dict[FixKind, dict[str, Any]] = {
    "gps": {"period": 1_000_000_000, "delay": 0, "loss": 0.0, "noise": 2.0, "noise_per_distance": 0.0, "depth": 0.5},
    "usbl": {"period": 5_000_000_000, "delay": 1_000_000_000, "loss": 0.1, "noise": 0.5, "noise_per_distance": 0.01},
    "lbl": {"period": 10_000_000_000, "delay": 1_000_000_000, "loss": 0.1, "noise": 1.0, "noise_per_distance": 0.001},
}


@dataclass(frozen=True, slots=True)
class GradeFile:
    """The content of a file with a grade."""

    name: str
    title: str
    grade: Grade


def shipped_grades() -> list[str]:
    """The grades that come with the package."""
    return data_files.shipped(_PACKAGE)


def load_grade(name: str, folder: Path | None = None) -> GradeFile:
    """A shipped grade by its name, or that of a file in `folder` (the scenario's) or in the current directory.

    Raises:
        DataFileError: with every mistake that was found.
    """
    data, path = data_files.find("grade", name, _PACKAGE, folder)
    values, problems = data_files.read("grade", data, path, ("name", "title", "grade"))
    numbers = table(values, "grade", NUMBERS, problems)
    problems += grade_problems(numbers)
    if problems:
        raise DataFileError("grade", path, problems)
    return GradeFile(str(values.get("name", name)), str(values.get("title", "")), Grade(**numbers))


def grade_problems(numbers: dict[str, float]) -> list[str]:
    """A line for each number that no instrument can have."""
    return out_of_range(numbers, NUMBERS, _BOUNDS)


def grade_of(section: NavigationSection, folder: Path | None) -> Grade:
    """The numbers of a section: those of its grade, unless the section gives another value. Raises DataFileError."""
    given = {key: getattr(section, key) for key in NUMBERS}
    missing = [key for key, value in given.items() if value is None]
    if not missing:
        return Grade(**given)
    base = load_grade(section.grade or DEFAULT_GRADE, folder).grade
    return Grade(**given | {key: getattr(base, key) for key in missing})


def navigation_of(section: NavigationSection | None, folder: Path | None) -> Navigation | None:
    """How a vehicle with this section navigates; None: it knows where it is.

    Raises:
        DataFileError: a file is missing or wrong.
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
    written = {key: value for key, value in section if value is not None}
    values = DEFAULTS[kind] | written
    return FixSource(
        kind=kind,
        period_ns=values["period"],
        delay_ns=values["delay"],
        loss=values["loss"],
        noise=values["noise"],
        growth=values["noise_per_distance"],
        at=values.get("at", (0.0, 0.0, 0.0)),
        reach=values.get("reach", 0.0),
        depth=values.get("depth", 0.0),
    )


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
        return section.model_copy(update={"trace": trace_text(section.trace, folder)})
    if section.grade is None or section.grade in shipped_grades():
        return section
    grade = grade_of(section, folder)
    return section.model_copy(update={"grade": DEFAULT_GRADE} | {key: getattr(grade, key) for key in NUMBERS})
