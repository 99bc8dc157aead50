"""study.json: what a study is."""

from __future__ import annotations

from pathlib import Path

import msgspec

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import MeasureColumn, columns_of_checks
from fleet.addons.studies.spec import MOST_ALLOWED, BoundarySpec, StudySpec, texts
from fleet.addons.studies.values import Axis
from fleet.errors import printable
from fleet.quantities import QuantityError
from netem.files import DamagedFile, read_json
from netem.limits import STUDY_RECORD
from netem.whole_file import write_whole

VERSION = 4
NAME = "study.json"


class AxisRecord(msgspec.Struct):
    """An axis as study.json has it: `unit` is None where the values are words."""

    key: str
    unit: str | None


class BorderRecord(BoundarySpec, frozen=True, kw_only=True):
    """The settings of a border's study, in the user's words; the border lies along its last axis."""

    log: bool  # whether equal ratios are equally far apart


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
    spec: StudySpec | None = None  # as people write it; of `fleet boundary` there is none
    border: BorderRecord | None = None  # of `fleet boundary`: not every point is run with every seed
    programs: bool = False  # whether its runs are those of a stack, on the wall clock

    @property
    def rules(self) -> StudySpec:
        """The spec; of a study without one its defaults."""
        return self.spec or StudySpec(self.scenario)

    @property
    def check(self) -> str:
        """The check that says whether a run passed; empty: all of them do."""
        return self.rules.check if self.border is None else self.border.check

    @property
    def every_column(self) -> list[MeasureColumn]:
        """The measures, and the numbers of each check."""
        return [*self.columns, *columns_of_checks(self.checks)]


def write_record(directory: Path, record: StudyRecord) -> None:
    """Write it. Raises OSError."""
    write_whole(directory / NAME, msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n", 0o666)


def read_record(directory: Path) -> StudyRecord:
    """The record of a study; anybody may have written it. Raises StudyError: there is none, it is damaged, or larger
    than a study writes."""
    file = directory / NAME
    try:
        if (found := read_json(file, _Version, STUDY_RECORD.bytes).version) != VERSION:
            old = ", whose rows are Parquet files" if found < VERSION else ""
            raise StudyError(
                f"{directory} is a study of version {found}{old}; this fleet reads version {VERSION} alone"
            )
        record = read_json(file, StudyRecord, STUDY_RECORD.bytes)
        _ = record.rules.timeout_s, record.rules.budget_s, record.border and record.border.timeout_s
    except FileNotFoundError:
        raise StudyError(f"{directory} is no study: it has no {NAME}") from None
    except OSError as error:
        raise StudyError(f"cannot read {file}: {error.strerror}") from None
    except (DamagedFile, OverflowError, QuantityError) as error:
        raise StudyError(f"{file} is damaged: {error!s:.200}") from None
    for what, names in (("axes", record.axes), ("checks", record.checks), ("columns", record.columns)):
        if len(names) > STUDY_RECORD.items:
            raise StudyError(f"{file} has {len(names)} {what}: at most {STUDY_RECORD.items} are possible")
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
    return AxisRecord(axis.key, axis.unit if axis.numeric else None)
