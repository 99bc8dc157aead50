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
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from fleet.errors import printable
from fleet.result.result import Status
from fleet.study.errors import StudyError
from fleet.study.one_run import FAILED
from fleet.study.parquet_file import MOST_BYTES, TEXT, read_table, write_table
from fleet.study.record import NAME, AxisRecord, StudyRecord, read_record, write_record
from fleet.study.spec import LARGEST_SEED
from fleet.study.stopping import Rule, parse_until, seed_sequence, seeds_needed
from fleet.study.values import AxisValue

if TYPE_CHECKING:
    import pandas as pd

_POINTS, _RUNS, _LOGS = "points.parquet", "runs", "logs"
_PART = re.compile(r"part-([0-9]{6,9})\.parquet")
_MOST_PARTS = 100_000  # one is written every ten seconds: eleven days
_MOST_BYTES = 1_000_000_000  # of all rows in memory: 1.4 million runs with all columns, more where some are read
_CHECKED = ("point", "seed", "status")  # in each reading
_STATUSES = (FAILED, *Status)
_TEXT, _BOOL, _NUMBER, _WHOLE = TEXT, pa.bool_(), pa.float64(), pa.int64()


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
            table = pa.table(columns, schema=store._point_schema)
            if table.nbytes > MOST_BYTES:
                size = f"{table.nbytes / 1e6:.0f} MB, more than {MOST_BYTES / 1e6:g} MB"
                raise StudyError(f"the points of the study take {size}: choose fewer points")
            write_table(directory / _POINTS, table)
            write_record(directory, record)
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
        record = read_record(directory)
        store = cls(directory, record)
        seeds = record.seeds
        if not seeds or len(set(seeds)) < len(seeds) or not 0 <= min(seeds) <= max(seeds) <= LARGEST_SEED:
            raise StudyError(f"{directory / NAME} is damaged: its seeds")
        if store.rule and len(seeds) > record.rules.most_seeds:
            raise StudyError(f"{directory / NAME} is damaged: its seeds are too many")
        names = Counter([*store.schema.names, "scenario"])  # which is a column of the points
        if twice := next((name for name, count in names.items() if count > 1), None):
            raise StudyError(f"{directory / NAME} is damaged: it has two columns {twice[:60]}")
        return store

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Have the study for writing.

        Raises:
            StudyError: another program has it.
        """
        with ExitStack() as stack:
            try:
                file = stack.enter_context((self.directory / NAME).open("rb"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise StudyError(f"another fleet runs the study {self.directory}") from None
            except OSError as error:
                raise StudyError(f"cannot lock {self.directory}: {error.strerror}") from None
            self._parts = 1 + max(
                self._part_files(), default=0
            )  # another program may have written some since it was opened
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
                *(pa.field(f"margin.{name}", _NUMBER) for name in checks if self.record.margins),
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
        return int(read_table(self.directory / _POINTS, self._point_schema, ["point"]).num_rows)

    @property
    def rule(self) -> Rule | None:
        """When a point has enough seeds; None: no seed is added. Raises StudyError."""
        until = self.record.rules.until
        return parse_until(until, self.record.columns) if until else None

    @property
    def seeds(self) -> list[int]:
        """All seeds that a point may have, in their order."""
        first, rules = self.record.seeds, self.record.rules
        return seed_sequence(first, rules.most_seeds) if rules.until else list(first)

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
        """The input of a rule, by point and seed."""
        by_point: dict[int, dict[int, dict[str, Any]]] = {}
        for row in self.table(["point", "seed", "status", "passed", *rule.columns]).to_pylist():
            by_point.setdefault(row["point"], {})[row["seed"]] = row
        return by_point

    @property
    def missing(self) -> int:
        """The number of runs without a row, among those that are known to be needed. Raises StudyError."""
        return 0 if self.record.border else sum(self.needed().values()) - len(self.done())

    def points(self) -> list[dict[str, Any]]:
        """Every point: `point`, its values by key, and `scenario`. Raises StudyError."""
        table = read_table(self.directory / _POINTS, self._point_schema)
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
            write_table(self.directory / _RUNS / f"part-{self._parts:06d}.parquet", table)
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
            broken = StudyError(
                f"cannot write the study {self.directory}: {why}; what was written before stays, and the study can be "
                "gone on with"
            )
            broken.status = 3  # nothing else should have been asked for
            raise broken from None
        self._parts += 1

    def table(self, columns: list[str] | None = None) -> pa.Table:
        """All rows, ordered by point and seed, so that their order does not tell who ran them.

        Args:
            columns: some; None: all.

        Raises:
            StudyError: the study is damaged, or holds more than a study writes.
        """
        whole = self.schema
        wanted = whole.names if columns is None else columns
        schema = pa.schema([whole.field(name) for name in dict.fromkeys([*wanted, *_CHECKED])])
        points, seeds, size = pa.array(range(self.point_count), _WHOLE), pa.array(self.seeds, _WHOLE), 0
        parts = [schema.empty_table()]
        for _, path in sorted(self._part_files().items()):
            part = read_table(path, whole, schema.names)
            size += part.nbytes
            if size > _MOST_BYTES:
                most = f"{_MOST_BYTES / 1e6:g} MB"
                raise StudyError(f"{self.directory} holds more than {most} of rows, too much to be read at once")
            for name, known in (("point", points), ("seed", seeds)):
                if not pc.all(pc.is_in(part[name], known), min_count=0).as_py():
                    raise StudyError(f"{path} is damaged: it has runs of points or seeds that are not its own")
            _check_statuses(path, part["status"])
            parts.append(part)
        table = pa.concat_tables(parts).sort_by([("point", "ascending"), ("seed", "ascending")])
        at, seed = table["point"].to_numpy(), table["seed"].to_numpy()
        twice = (at[1:] == at[:-1]) & (seed[1:] == seed[:-1])
        if twice.any():
            first = int(twice.argmax())
            raise StudyError(
                f"{self.directory / _RUNS} is damaged: point {at[first]} has two rows with seed {seed[first]}, and one "
                f"was expected ({int(twice.sum())} rows too many): was a file copied there?"
            )
        return table.select(wanted)

    def _part_files(self) -> dict[int, Path]:
        """The files of rows, by number. Raises StudyError: there are too many, or two of one number."""
        found: dict[int, Path] = {}
        try:
            with os.scandir(self.directory / _RUNS) as entries:
                for entry in entries:
                    if (match := _PART.fullmatch(entry.name)) is None:
                        continue
                    if int(match[1]) in found:
                        raise StudyError(f"{self.directory / _RUNS} has two files with the number of {entry.name}")
                    if len(found) == _MOST_PARTS:
                        raise StudyError(f"{self.directory / _RUNS} has more files than a study writes: {_MOST_PARTS}")
                    found[int(match[1])] = Path(entry.path)
        except FileNotFoundError:
            return found
        except OSError as error:
            raise StudyError(f"cannot read {self.directory / _RUNS}: {error.strerror}") from None
        return found

    def frame(self) -> pd.DataFrame:
        """All rows as a pandas DataFrame; `attrs["units"]` has the unit of each column. Raises StudyError."""
        table = self.table()
        frame = table.to_pandas()
        units = {field.name: _unit(field) for field in table.schema if _unit(field)}
        frame.attrs["units"] = units
        return frame


def _check_statuses(path: Path, statuses: pa.ChunkedArray) -> None:
    """Raises StudyError: a run has a status that no run has."""
    known = pc.is_in(statuses, pa.array(_STATUSES, _TEXT))
    if not pc.all(known, min_count=0).as_py():
        strange = statuses.filter(pc.invert(known))[0].as_py()
        shown = "none" if strange is None else printable(strange[:60])
        raise StudyError(f"{path} is damaged: a run has the status {shown}, expected one of {', '.join(_STATUSES)}")


def cell(axis: AxisRecord, value: AxisValue) -> float | str | None:
    """A value as a table has it: a number in the axis' unit, or a word."""
    return value.text if axis.unit is None else value.number


def _column(axis: AxisRecord, values: Sequence[AxisValue]) -> pa.Array:
    return pa.array([cell(axis, value) for value in values], _TEXT if axis.unit is None else _NUMBER)


def _axis_field(axis: AxisRecord) -> pa.Field:
    return _unit_field(axis.key, _TEXT if axis.unit is None else _NUMBER, axis.unit or "")


def _unit_field(name: str, kind: pa.DataType, unit: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit} if unit else None)


def _unit(field: pa.Field) -> str:
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode()
