"""study.json: what a study is."""

from __future__ import annotations

from pathlib import Path

import msgspec

from fleet.errors import printable
from fleet.quantities import QuantityError
from fleet.study.errors import StudyError
from fleet.study.measures import Column
from fleet.study.settings import MOST_ALLOWED, Settings
from fleet.study.spec import StudySpec
from fleet.study.values import Axis
from netem.whole_file import read_file, write_whole

VERSION = 2
NAME = "study.json"
_MOST_BYTES = 32_000_000  # a million seeds
_MOST_NAMES = 1000  # axes, checks or columns


class AxisRecord(msgspec.Struct):
    """An axis as study.json has it: `unit` is None where the values are words."""

    key: str
    unit: str | None


class BorderRecord(msgspec.Struct):
    """What a study of a border looks for: where the pass rate falls through a level along its last axis."""

    level: float
    width: float  # of an interval that is narrow enough, as a share of the range
    log: bool  # whether equal ratios are equally far apart


class _Version(msgspec.Struct):
    version: int


class StudyRecord(msgspec.Struct):
    """study.json."""

    version: int
    scenario: str  # its name
    command: str  # the changes of every run, for people
    axes: list[AxisRecord]
    seeds: list[int]  # of every point; the first ones, if seeds are added
    checks: list[str]  # of the scenario, by name
    columns: list[Column]  # of measures
    settings: Settings
    made_by: str  # the version of the package
    folder: str | None = None  # of the scenario's file: where laws are looked for, which need trust all the same
    spec: StudySpec | None = None  # as people write it; older versions of fleet did not keep it
    border: BorderRecord | None = None  # of `fleet boundary`: not every point is run with every seed


def write_record(directory: Path, record: StudyRecord) -> None:
    """Write it. Raises OSError."""
    write_whole(directory / NAME, msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n")


def read_record(directory: Path) -> StudyRecord:
    """What a study is, which may come from anybody.

    Raises:
        StudyError: there is none, it is damaged, or larger than a study writes.
    """
    file = directory / NAME
    try:
        data = read_file(file, _MOST_BYTES)
        if (found := msgspec.json.decode(data, type=_Version).version) != VERSION:
            raise StudyError(f"{directory}: a study of version {found}; this fleet reads version {VERSION}")
        record = msgspec.json.decode(data, type=StudyRecord)
        if record.spec is not None:
            _ = record.spec.timeout_s, record.spec.budget_s
    except FileNotFoundError:
        raise StudyError(f"{directory} is no study: it has no {NAME}") from None
    except OSError as error:
        raise StudyError(f"cannot read {file}: {error.strerror}") from None
    except (msgspec.MsgspecError, OverflowError, UnicodeDecodeError, QuantityError) as error:
        raise StudyError(f"{file} is damaged: {error!s:.200}") from None
    for what, names in (("axes", record.axes), ("checks", record.checks), ("columns", record.columns)):
        if len(names) > _MOST_NAMES:
            raise StudyError(f"{file} has {len(names)} {what}, and {_MOST_NAMES} at most may be")
    if len(record.seeds) > MOST_ALLOWED:
        raise StudyError(f"{file} has {len(record.seeds)} seeds, and {MOST_ALLOWED} at most may be")
    texts = [
        record.scenario,
        record.command,
        *record.checks,
        *(() if record.spec is None else record.spec.texts()),
        *(text for column in record.columns for text in (column.name, column.unit)),
        *record.settings.measures,
        record.settings.until or "",
        *(text for axis in record.axes for text in (axis.key, axis.unit or "")),
    ]
    if any(printable(text) != text for text in texts):  # a study may come from anybody, and is shown on a terminal
        raise StudyError(f"{file} is damaged: a text in it has control characters")
    return record


def axis_record(axis: Axis) -> AxisRecord:
    """How study.json has an axis."""
    return AxisRecord(axis.key, axis.unit if axis.numeric else None)
