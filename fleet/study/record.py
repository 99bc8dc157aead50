"""study.json: what a study is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from fleet.errors import printable
from fleet.quantities import QuantityError
from fleet.study.errors import StudyError
from fleet.study.measures import MeasureColumn
from fleet.study.spec import MOST_ALLOWED, BoundarySpec, KeepLogs, StudySpec, texts
from fleet.study.values import Axis
from netem.private_file import read_file, write_whole

VERSION = 3
_WITH_SETTINGS = 2  # the version before
NAME = "study.json"
_MOST_BYTES = 32_000_000  # a million seeds
_MOST_NAMES = 1000  # axes, checks or columns


class AxisRecord(msgspec.Struct):
    """An axis as study.json has it: `unit` is None where the values are words."""

    key: str
    unit: str | None


class BorderRecord(BoundarySpec, frozen=True, kw_only=True):
    """The settings of a border's study, in the user's words; the border lies along its last axis."""

    log: bool  # whether equal ratios are equally far apart


class OldSettings(msgspec.Struct, frozen=True):
    """The settings that version 2 had in addition to the spec."""

    measures: tuple[str, ...] = ()
    until: str | None = None
    most_seeds: Annotated[int, Meta(ge=1, le=MOST_ALLOWED)] = 1000
    keep_logs: KeepLogs = "none"


class _Version(msgspec.Struct):
    version: int


class StudyRecord(msgspec.Struct, omit_defaults=True):
    """study.json."""

    version: int
    scenario: str  # its name
    command: str  # the changes of every run, for people
    axes: list[AxisRecord]
    seeds: list[int]  # of every point; the first ones, if seeds are added
    checks: list[str]  # of the scenario, by name
    columns: list[MeasureColumn]  # of measures
    made_by: str  # the version of the package
    measures: tuple[str, ...] = ()  # that the table shows, as columns are named
    folder: str | None = None  # of the scenario's file: where laws are looked for, which need trust all the same
    spec: StudySpec | None = None  # as people write it; older versions of fleet did not keep it
    border: BorderRecord | None = None  # of `fleet boundary`: not every point is run with every seed
    settings: OldSettings | None = None  # of version 2 only
    margins: bool = False  # whether the table has those of the checks; that of an older version of fleet has none

    @property
    def rules(self) -> StudySpec:
        """The spec; of a study without one as much of it as is known."""
        if self.spec is not None or self.settings is None:
            return self.spec or StudySpec(self.scenario)
        old = self.settings
        return StudySpec(self.scenario, until=old.until or "", most_seeds=old.most_seeds, keep_logs=old.keep_logs)


def write_record(directory: Path, record: StudyRecord) -> None:
    """Write it. Raises OSError."""
    write_whole(directory / NAME, msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n")


def read_record(directory: Path) -> StudyRecord:
    """The record of a study; anybody may have written it.

    Raises:
        StudyError: there is none, it is damaged, or larger than a study writes.
    """
    file = directory / NAME
    try:
        data = read_file(file, _MOST_BYTES)
        if (found := msgspec.json.decode(data, type=_Version).version) not in (_WITH_SETTINGS, VERSION):
            known = f"versions {_WITH_SETTINGS} and {VERSION}"
            raise StudyError(f"{directory}: a study of version {found}; this fleet reads {known}")
        record = msgspec.json.decode(data, type=StudyRecord)
        if record.settings is not None:
            record.measures = record.settings.measures
        _ = record.rules.timeout_s, record.rules.budget_s, record.border and record.border.timeout_s
    except FileNotFoundError:
        raise StudyError(f"{directory} is no study: it has no {NAME}") from None
    except OSError as error:
        raise StudyError(f"cannot read {file}: {error.strerror}") from None
    except (msgspec.MsgspecError, OverflowError, UnicodeDecodeError, QuantityError) as error:
        raise StudyError(f"{file} is damaged: {error!s:.200}") from None
    for what, names in (("axes", record.axes), ("checks", record.checks), ("columns", record.columns)):
        if len(names) > _MOST_NAMES:
            raise StudyError(f"{file} has {len(names)} {what}: at most {_MOST_NAMES} are possible")
    if len(record.seeds) > MOST_ALLOWED:
        raise StudyError(f"{file} has {len(record.seeds)} seeds: at most {MOST_ALLOWED} are possible")
    every = [
        record.scenario,
        record.command,
        *record.checks,
        *texts(record.rules),
        *(() if record.border is None else texts(record.border)),
        *(text for column in record.columns for text in (column.name, column.unit)),
        *record.measures,
        *(text for axis in record.axes for text in (axis.key, axis.unit or "")),
    ]
    if any(printable(text) != text for text in every):  # a study may come from anybody, and is shown on a terminal
        raise StudyError(f"{file} is damaged: a text in it has control characters")
    return record


def axis_record(axis: Axis) -> AxisRecord:
    """How study.json has an axis."""
    return AxisRecord(axis.key, axis.unit if axis.numeric else None)
