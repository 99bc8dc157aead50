"""The directory of a study: what is to be run, and one row per run that was made, as Parquet files.

```text
DIR/study.json         what the study is: scenario, axes with units, seeds, versions
DIR/points.parquet     one row per point: its values and its whole scenario
DIR/runs/*.parquet     one row per run, in the order in which they ended
DIR/logs/point-3-seed-7/    with --keep-logs: what `fleet run` would have written
```

A file is written beside its name and then renamed, so whatever ends the program, what stands there is whole.
"""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fleet.errors import printable
from fleet.quantities import QuantityError
from fleet.study.errors import StudyError
from fleet.study.measures import Column
from fleet.study.settings import LARGEST_SEED, Settings
from fleet.study.spec import StudySpec
from fleet.study.stopping import Rule, parse_until, seed_sequence, seeds_needed
from fleet.study.values import Axis, Value
from netem.whole_file import read_file, write_whole

if TYPE_CHECKING:
    import pandas as pd

VERSION = 2
_STUDY, _POINTS, _RUNS, _LOGS = "study.json", "points.parquet", "runs", "logs"
_MOST_BYTES = 200_000_000
MOST_ROWS = 100_000  # of a file
_TEXT, _BOOL, _NUMBER, _WHOLE = pa.string(), pa.bool_(), pa.float64(), pa.int64()


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


class Store:
    """The directory of one study. Two programs cannot run one study: see `locked`."""

    def __init__(self, directory: Path, record: StudyRecord) -> None:
        self.directory, self.record = directory, record
        self._parts = 1

    @classmethod
    def create(cls, directory: Path, record: StudyRecord, points: Sequence[Mapping[str, Any]]) -> Store:
        """Make the directory of a new study.

        Args:
            points: of each point `values` by key, and `scenario`, its whole text.

        Raises:
            StudyError: the directory is there already and not empty, or cannot be written.
        """
        try:
            (directory / _RUNS).mkdir(parents=True)
            store = cls(directory, record)
            columns: dict[str, Any] = {"point": pa.array(range(len(points)), _WHOLE)}
            for axis in record.axes:
                columns[axis.key] = _column(axis, [point["values"][axis.key] for point in points])
            columns["scenario"] = pa.array([point["scenario"] for point in points], _TEXT)
            _write(directory / _POINTS, pa.table(columns, schema=store._point_schema))
            write_whole(directory / _STUDY, msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n")
        except FileExistsError:
            raise StudyError(f"{directory} is there already: choose another place") from None
        except OSError as error:
            raise StudyError(f"cannot make the study {directory}: {error.strerror}") from None
        return store

    @classmethod
    def open(cls, directory: Path) -> Store:
        """The store of a study that is there.

        Raises:
            StudyError: there is none, or it is damaged.
        """
        try:
            data = read_file(directory / _STUDY, _MOST_BYTES)
            if (found := msgspec.json.decode(data, type=_Version).version) != VERSION:
                raise StudyError(f"{directory}: a study of version {found}; this fleet reads version {VERSION}")
            record = msgspec.json.decode(data, type=StudyRecord)
            if record.spec is not None:
                _ = record.spec.timeout_s, record.spec.budget_s
        except FileNotFoundError:
            raise StudyError(f"{directory} is no study: it has no {_STUDY}") from None
        except OSError as error:
            raise StudyError(f"cannot read {directory / _STUDY}: {error.strerror}") from None
        except (msgspec.MsgspecError, OverflowError, UnicodeDecodeError, QuantityError) as error:
            raise StudyError(f"{directory / _STUDY} is damaged: {error!s:.200}") from None
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
            raise StudyError(f"{directory / _STUDY} is damaged: a text in it has control characters")
        store = cls(directory, record)
        seeds = record.seeds
        if not seeds or len(set(seeds)) < len(seeds) or not 0 <= min(seeds) <= max(seeds) <= LARGEST_SEED:
            raise StudyError(f"{directory / _STUDY} is damaged: its seeds")
        if store.rule and len(seeds) > record.settings.most_seeds:
            raise StudyError(f"{directory / _STUDY} is damaged: its seeds are too many")
        names = Counter([*store.schema.names, "scenario"])  # which is a column of the points
        if twice := next((name for name, count in names.items() if count > 1), None):
            raise StudyError(f"{directory / _STUDY} is damaged: it has two columns {twice[:60]}")
        return store

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Have the study for writing.

        Raises:
            StudyError: another program has it.
        """
        with ExitStack() as stack:
            try:
                file = stack.enter_context((self.directory / _STUDY).open("rb"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise StudyError(f"another fleet runs the study {self.directory}") from None
            except OSError as error:
                raise StudyError(f"cannot lock {self.directory}: {error.strerror}") from None
            self._parts = _next_part(self.directory)  # another program may have written some since it was opened
            with suppress(OSError):
                for left in (self.directory / _RUNS).glob("*.part"):
                    left.unlink()
            yield

    @property
    def _point_schema(self) -> pa.Schema:
        fields = [pa.field("point", _WHOLE), *map(_axis_field, self.record.axes), pa.field("scenario", _TEXT)]
        return pa.schema(fields)

    @property
    def schema(self) -> pa.Schema:
        """Of a row of a run, with the unit of each column."""
        checks = self.record.checks
        return pa.schema(
            [
                pa.field("key", _TEXT), pa.field("point", _WHOLE), pa.field("seed", _WHOLE),
                *map(_axis_field, self.record.axes),
                pa.field("status", _TEXT), pa.field("reason", _TEXT), pa.field("passed", _BOOL),
                *(pa.field(f"check.{name}", _BOOL) for name in checks),
                *(pa.field(f"value.{name}", _NUMBER) for name in checks),
                *(_unit_field(column.name, _NUMBER, column.unit) for column in self.record.columns),
                pa.field("digest", _TEXT), pa.field("version", _TEXT), pa.field("cores", _TEXT),
            ]
        )  # fmt: skip

    def log_of(self, point: int, seed: int) -> Path:
        """The run directory of one of its runs; it is there only if its log was kept."""
        return self.directory.resolve() / _LOGS / f"point-{point}-seed-{seed}"

    @property
    def folder(self) -> Path | None:
        """Where laws are looked for besides the current directory."""
        return None if self.record.folder is None else Path(self.record.folder)

    @property
    def point_count(self) -> int:
        """How many points there are. Raises StudyError."""
        return int(_read(self.directory / _POINTS, ["point"]).num_rows)

    @property
    def rule(self) -> Rule | None:
        """When a point has enough seeds; None: no seed is added. Raises StudyError."""
        until = self.record.settings.until
        return None if until is None else parse_until(until, self.record.columns)

    @property
    def seeds(self) -> list[int]:
        """All seeds that a point may have, in the order in which it gets them."""
        first, settings = self.record.seeds, self.record.settings
        return list(first) if settings.until is None else seed_sequence(first, settings.most_seeds)

    def needed(self, before: Mapping[int, int] | None = None) -> dict[int, int]:
        """How many seeds each point needs, as far as its rows show; none, where a border is looked for.

        Args:
            before: what was needed earlier, which saves the way there.

        Raises:
            StudyError: the study is damaged.
        """
        first = dict.fromkeys(range(self.point_count), 0 if self.record.border else len(self.record.seeds))
        first |= before or {}
        if (rule := self.rule) is None or self.record.border:
            return first
        by_point, seeds = self._rows_of(rule), self.seeds
        return {n: seeds_needed(rule, by_point.get(n, {}), seeds, needed) for n, needed in first.items()}

    def short(self) -> int:
        """How many points may have no more seeds, though more would be needed. Raises StudyError."""
        rule, seeds = self.rule, self.seeds
        if rule is None:
            return 0
        ended = self._rows_of(rule)
        full = [list(rows.values()) for rows in ended.values() if len(rows) == len(seeds)]
        return sum(not rule.met(rule.estimate(rows)) for rows in full)

    def _rows_of(self, rule: Rule) -> dict[int, dict[int, dict[str, Any]]]:
        """What a rule looks at, by point and seed."""
        by_point: dict[int, dict[int, dict[str, Any]]] = {}
        for row in self.table(["point", "seed", "status", "passed", *rule.columns]).to_pylist():
            by_point.setdefault(row["point"], {})[row["seed"]] = row
        return by_point

    @property
    def missing(self) -> int:
        """How many runs have no row yet, of those that are known to be needed. Raises StudyError."""
        return 0 if self.record.border else sum(self.needed().values()) - len(self.done())

    def points(self) -> list[dict[str, Any]]:
        """Every point: `point`, its values by key, and `scenario`. Raises StudyError."""
        table = _read(self.directory / _POINTS)
        if not table.schema.equals(self._point_schema):
            raise StudyError(f"{self.directory / _POINTS} has other columns than {self.directory / _STUDY} says")
        rows: list[dict[str, Any]] = table.to_pylist()
        if any(None in row.values() for row in rows):
            raise StudyError(f"{self.directory / _POINTS} has a point without a value")
        if [row["point"] for row in rows] != list(range(len(rows))):
            raise StudyError(f"{self.directory} is damaged: its points are not numbered")
        return rows

    def done(self) -> set[tuple[int, int]]:
        """(point, seed) of every run that has a row. Raises StudyError."""
        table = self.table(["point", "seed"])
        return set(zip(table["point"].to_pylist(), table["seed"].to_pylist(), strict=True))

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write rows of runs as one more file. Raises StudyError."""
        schema = self.schema
        table = pa.Table.from_pylist([{name: row.get(name) for name in schema.names} for row in rows], schema=schema)
        try:
            _write(self.directory / _RUNS / f"part-{self._parts:06d}.parquet", table)
        except OSError as error:
            raise StudyError(f"cannot write the study {self.directory}: {error.strerror}") from None
        self._parts += 1

    def table(self, columns: list[str] | None = None) -> pa.Table:
        """All rows, ordered by point and seed, so that their order does not tell who ran them. Raises StudyError."""
        schema = self.schema
        if columns is not None:
            schema = pa.schema([schema.field(name) for name in columns])
        parts = []
        for path in sorted((self.directory / _RUNS).glob("part-*.parquet")):
            part = _read(path, columns)
            if not part.schema.equals(schema):
                raise StudyError(f"{path} has other columns than {self.directory / _STUDY} says")
            parts.append(part)
        table = pa.concat_tables(parts) if parts else schema.empty_table()
        own = (("point", range(self.point_count)), ("seed", self.seeds))
        if not all(pc.all(pc.is_in(table[name], pa.array(known, _WHOLE)), min_count=0).as_py() for name, known in own):
            raise StudyError(f"{self.directory} is damaged: it has runs of points or seeds that are not its own")
        return table.sort_by([("point", "ascending"), ("seed", "ascending")])

    def frame(self) -> pd.DataFrame:
        """All rows as a pandas DataFrame; `attrs["units"]` has the unit of each column. Raises StudyError."""
        table = self.table()
        frame = table.to_pandas()
        units = {field.name: _unit(field) for field in table.schema if _unit(field)}
        frame.attrs["units"] = units
        return frame


def axis_record(axis: Axis) -> AxisRecord:
    """How study.json has an axis."""
    return AxisRecord(axis.key, axis.unit if axis.numeric else None)


def cell(axis: AxisRecord, value: Value) -> float | str | None:
    """A value as a table has it: a number in the axis' unit, or a word."""
    return value.text if axis.unit is None else value.number


def _column(axis: AxisRecord, values: Sequence[Value]) -> pa.Array:
    return pa.array([cell(axis, value) for value in values], _TEXT if axis.unit is None else _NUMBER)


def _axis_field(axis: AxisRecord) -> pa.Field:
    return _unit_field(axis.key, _TEXT if axis.unit is None else _NUMBER, axis.unit or "")


def _unit_field(name: str, kind: pa.DataType, unit: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit} if unit else None)


def _unit(field: pa.Field) -> str:
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode()


def _next_part(directory: Path) -> int:
    names = [path.stem.partition("-")[2] for path in (directory / _RUNS).glob("part-*.parquet")]
    return 1 + max((int(name) for name in names if name.isdecimal()), default=0)


def _write(path: Path, table: pa.Table) -> None:
    part = path.with_suffix(".part")
    pq.write_table(table, part, compression="zstd")
    os.replace(part, path)


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    try:
        about = pq.read_metadata(path)
        groups = [about.row_group(k) for k in range(about.num_row_groups)]
        size = sum(group.total_byte_size for group in groups)  # a small file may hold much
        if size > _MOST_BYTES or about.num_rows > MOST_ROWS:
            raise StudyError(f"{path} holds {about.num_rows} rows and {size} bytes, more than a study writes")
        return pq.read_table(path, columns=columns)
    except FileNotFoundError:
        raise StudyError(f"{path} is missing") from None
    except (OSError, pa.ArrowException) as error:
        raise StudyError(f"{path} cannot be read: {error!s:.200}") from None
