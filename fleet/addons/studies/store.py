"""The directory of a study: what is to be run, and one row per run that was made.

```text
DIR/study.json         what the study is: scenario, axes with units, seeds, versions
DIR/study.sqlite       table `points`: the values of each point and its whole scenario; table `runs`: a row per run
DIR/logs/point-3-seed-7/    with --keep-logs: what `fleet run` would have written
```

The key of a run is (point, seed), so each run counts once. Rows are written in transactions, so whatever ends the
program, the runs of all earlier batches are there.

A study may come from anybody. Its database must be a small enough file with exactly the two tables that study.json
calls for. It is opened to be read only, and checked before it is used.
"""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import cached_property
from itertools import islice
from pathlib import Path
from stat import S_ISREG
from typing import TYPE_CHECKING, Any, NamedTuple

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import CHECK
from fleet.addons.studies.record import NAME, AxisRecord, StudyRecord, read_record, write_record
from fleet.addons.studies.row import STATUSES, CheckRow, Row, run_name
from fleet.addons.studies.spec import LARGEST_SEED
from fleet.addons.studies.stopping import Rule, parse_until, seed_sequence, seeds_needed
from fleet.addons.studies.values import AxisValue
from netem.limits import STUDY_ROWS
from netem.whole_file import part_of, sync_folder

if TYPE_CHECKING:
    import pandas as pd

FILE, _LOGS = "study.sqlite", "logs"
_MOST_POINT_BYTES = 200_000_000  # of the scenarios of all points
_MOST_TEXTS = 400_000_000  # characters that are held at once
_CHUNK = 10_000  # rows that are read before they become arrays
_MOST_TEXT = 16_000_000  # bytes of one value
_MOST_CELLS = 200_000_000  # that are read at once
_AT_ONCE = 200  # columns of one condition, which SQLite nests
_WAIT_S = 60.0  # for a program that writes a batch
_HEADER = b"SQLite format 3\0"
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")  # at the end of a journal that names other files
_DETAILS = ("key", "reason", "digest", "version", "cores")


class StudyPoint(NamedTuple):
    number: int
    values: dict[str, float | str]  # by key of the axis
    scenario: str  # its whole text


class Column(NamedTuple):
    name: str
    kind: str  # of SQLite
    unit: str = ""


class Store:
    """The directory of one study. Two programs cannot run one study: see `lock`."""

    def __init__(self, directory: Path, record: StudyRecord) -> None:
        self.directory, self.record = directory, record
        self._file = directory / FILE
        self._writer: sqlite3.Connection | None = None
        self._checked = False

    @classmethod
    def create(
        cls,
        directory: Path | Iterable[Path],
        record: StudyRecord,
        points: Sequence[tuple[Mapping[str, AxisValue], str]],
    ) -> Store:
        """Make the directory of a new study. `directory`: of several the first one that is free is taken. `points`: the
        values of each by key, and its whole scenario. Raises StudyError: the directory is there already, or cannot be
        written."""
        others = iter([directory] if isinstance(directory, Path) else directory)
        directory = next(others)
        store = cls(directory, record)
        size = sum(len(text) for _, text in points)
        if size > _MOST_POINT_BYTES:
            most = f"{size / 1e6:.0f} MB, more than {_MOST_POINT_BYTES / 1e6:g} MB"
            raise StudyError(f"the points of the study take {most}: choose fewer points")
        rows = [
            (number, *(cell(axis, values[axis.key]) for axis in record.axes), text)
            for number, (values, text) in enumerate(points)
        ]
        # Whoever is killed here leaves no half study: it gets its name when it is whole.
        part = part_of(directory)
        try:
            part.mkdir(parents=True)
            (part / FILE).touch()  # or SQLite would take rights from the group that the umask leaves
            with closing(sqlite3.connect(part / FILE)) as file, file:
                for table in store._tables:
                    file.execute(table)
                file.executemany(f"INSERT INTO points VALUES ({_places(2 + len(record.axes))})", rows)
            write_record(part, record)
            while not _rename(part, directory):
                if (other := next(others, None)) is None:
                    raise StudyError(f"{directory} is there already: choose another place")
                directory = other
            sync_folder(directory.parent)
        except OSError as error:
            raise StudyError(f"cannot make the study {directory}: {error.strerror}") from None
        except sqlite3.Error as error:
            raise StudyError(f"cannot make the study {directory}: {error}") from None
        finally:
            shutil.rmtree(part, ignore_errors=True)
        store = cls(directory, record)
        store._checked = True
        return store

    @classmethod
    def open(cls, directory: Path) -> Store:
        """The store of a study that is there. Raises StudyError: there is none, or it is damaged."""
        record = read_record(directory)
        store = cls(directory, record)
        seeds = record.seeds
        if not seeds or len(set(seeds)) < len(seeds) or not 0 <= min(seeds) <= max(seeds) <= LARGEST_SEED:
            raise StudyError(f"{directory / NAME} is damaged: its seeds")
        if store.rule and len(seeds) > record.rules.most_seeds:
            raise StudyError(f"{directory / NAME} is damaged: its seeds are too many")
        names = Counter([*(axis.key for axis in record.axes), *(each.name for each in store.columns), "scenario"])
        if twice := next((name for name, count in names.items() if count > 1), None):
            raise StudyError(f"{directory / NAME} is damaged: it has two columns {twice[:60]}")
        if record.check and record.check not in record.checks:
            raise StudyError(f"{directory / NAME} is damaged: it has no check {record.check[:60]}")
        store._recover()
        return store

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Have the study for writing. Raises StudyError: another program has it."""
        with ExitStack() as stack:
            if not stack.enter_context(self._lock()):
                raise StudyError(f"another fleet runs the study {self.directory}")
            self._writer = stack.enter_context(closing(self._connect("rw")))
            stack.callback(setattr, self, "_writer", None)
            yield

    @contextmanager
    def _lock(self) -> Iterator[bool]:
        try:
            with (self.directory / NAME).open("rb") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    had = True
                except BlockingIOError:
                    had = False
                yield had
        except OSError as error:
            raise StudyError(f"cannot lock {self.directory}: {error.strerror}") from None

    def _recover(self) -> None:
        """Undo the batch in which an earlier program was killed; its journal lies beside the database."""
        journal = self.directory / f"{FILE}-journal"
        if not journal.exists():
            return
        with self._lock() as alone:
            if not alone:  # the journal is that of a program that goes on
                return
            try:
                if not S_ISREG(journal.lstat().st_mode):
                    raise StudyError(f"{journal} is damaged")
                with journal.open("rb") as end:
                    end.seek(-min(journal.stat().st_size, len(_SUPER_JOURNAL)), os.SEEK_END)
                    if end.read() == _SUPER_JOURNAL:  # SQLite would delete a file that it names
                        raise StudyError(f"{journal} is damaged")
            except FileNotFoundError:
                return
            except OSError as error:
                raise StudyError(f"{journal} cannot be read: {error.strerror}") from None
            try:
                with _no_larger(self._file), closing(self._connect("rw")) as file:
                    file.execute("BEGIN IMMEDIATE")
                    file.rollback()
            except (OSError, sqlite3.Error, StudyError) as error:
                raise StudyError(
                    f"{self._file} was left in the middle of a batch, and cannot be mended: {error}"
                ) from None

    @cached_property
    def columns(self) -> list[Column]:
        checks = self.record.checks
        return [
            Column("point", "INTEGER"), Column("seed", "INTEGER"),
            Column("key", "TEXT"), Column("status", "TEXT"), Column("reason", "TEXT"), Column("passed", "INTEGER"),
            *(Column(f"check.{name}", "INTEGER") for name in checks),
            *(Column(f"value.{name}", "REAL") for name in checks),
            *(Column(f"margin.{name}", "REAL") for name in checks),
            *(Column(each.name, "REAL", each.unit) for each in self.record.columns),
            Column("digest", "TEXT"), Column("version", "TEXT"), Column("cores", "TEXT"),
        ]  # fmt: skip

    @property
    def _axes(self) -> list[Column]:
        return [Column(axis.key, "TEXT" if axis.unit is None else "REAL", axis.unit or "") for axis in self.record.axes]

    @cached_property
    def _tables(self) -> tuple[str, str]:
        """The statements that make both tables; those of the file must be the same."""
        points = [f'"{self._sql[name]}" {kind} NOT NULL' for name, kind, _ in self._axes]
        runs = [f'"{self._sql[name]}" {kind}' for name, kind, _ in self.columns]
        whole = ", ".join(['"point" INTEGER PRIMARY KEY', *points, '"scenario" TEXT NOT NULL'])
        rows = ", ".join([*runs, "PRIMARY KEY (point, seed)"])
        return f"CREATE TABLE points ({whole})", f"CREATE TABLE runs ({rows}) WITHOUT ROWID"

    @cached_property
    def _sql(self) -> dict[str, str]:
        """The name of each column in SQLite, where names that differ only in their case are the same."""
        found = {"scenario": "scenario"}
        taken = {"point", "scenario"}
        for name in [*(axis.key for axis in self.record.axes), *(column.name for column in self.columns)]:
            sql = name.replace('"', '""')
            while sql.lower() in taken and name != "point":
                sql += "_"
            taken.add(sql.lower())
            found[name] = sql
        return found

    def _connect(self, mode: str) -> sqlite3.Connection:
        try:
            about = self._file.stat()
            if not S_ISREG(about.st_mode):
                raise StudyError(f"{self._file} is no regular file")
            if about.st_size > STUDY_ROWS.bytes:
                raise StudyError(f"{self._file} is larger than {STUDY_ROWS.bytes / 1e9:g} GB")
            if not self._checked:
                with self._file.open("rb") as start:
                    head = start.read(20)
                if not head.startswith(_HEADER) or head[18:] != b"\1\1":  # another journal would make more files
                    raise StudyError(f"{self._file} is damaged: no database of a study")
            file = sqlite3.connect(f"{self._file.resolve().as_uri()}?mode={mode}", _WAIT_S, uri=True)
        except FileNotFoundError:
            raise StudyError(f"{self._file} is missing") from None
        except (OSError, sqlite3.Error) as error:
            raise StudyError(f"{self._file} cannot be read: {error}") from None
        try:
            file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_TEXT)
            with self._errors():
                file.execute("PRAGMA trusted_schema = OFF")
                file.execute("PRAGMA cell_size_check = ON")
                file.execute(f"PRAGMA max_page_count = {STUDY_ROWS.bytes // 4096}")
                if not self._checked:
                    self._check(file)
                    self._checked = True
        except BaseException:
            file.close()
            raise
        return file

    def _check(self, file: sqlite3.Connection) -> None:
        """Raises StudyError: it holds something else than a study writes."""
        tables = [sql for (sql,) in file.execute("SELECT sql FROM sqlite_master ORDER BY name LIMIT 3")]
        if tables != list(self._tables):
            raise StudyError(f"{self._file} is damaged: its tables are not those that {NAME} calls for")
        ((found,),) = file.execute("PRAGMA quick_check(1)")
        if found != "ok":
            raise StudyError(f"{self._file} is damaged: {str(found)[:200]!r}")
        points = [number for (number,) in file.execute("SELECT point FROM points")]
        if points != list(range(len(points))):
            raise StudyError(f"{self._file} is damaged: its points are not numbered")
        self._check_types(file, "points", [*self._axes, Column("scenario", "TEXT")])
        self._check_types(file, "runs", self.columns)
        known, seeds, before = len(points), set(self.seeds), (-1, -1)
        for run in file.execute("SELECT point, seed FROM runs ORDER BY point, seed"):
            if run[0] not in range(known) or run[1] not in seeds:
                raise StudyError(f"{self._file} is damaged: it has runs of points or seeds that are not its own")
            if run <= before:
                raise StudyError(f"{self._file} is damaged: point {run[0]} has two rows with seed {run[1]}")
            before = run

    def _check_types(self, file: sqlite3.Connection, table: str, columns: Sequence[Column]) -> None:
        """SQLite takes any value in any column, and checks no constraint of a file that it only reads."""
        for k in range(0, len(columns), _AT_ONCE):
            some = columns[k : k + _AT_ONCE]
            wrong = [f"typeof(\"{self._sql[name]}\") NOT IN ('{kind.lower()}', 'null')" for name, kind, _ in some]
            if table == "runs":
                wrong.append(f"status IS NULL OR status NOT IN ({', '.join(map(repr, map(str, STATUSES)))})")
            for (point,) in file.execute(f"SELECT point FROM {table} WHERE {' OR '.join(wrong)} LIMIT 1"):
                raise StudyError(f"{self._file} is damaged: point {point} has a value of another type in {table}")

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
            raise StudyError(f"{self._file} cannot be read: {error!s:.200}") from None

    def _each(self, wanted: str, source: str, order: str) -> Iterator[tuple[Any, ...]]:
        with closing(self._connect("ro")) as file, self._errors():
            ((count,),) = file.execute(f"SELECT count(*) FROM {source}")
            if count * (1 + wanted.count(",")) > _MOST_CELLS:
                raise StudyError(f"{self.directory} has {count} rows, too many to be read at once")
            yield from file.execute(f"SELECT {wanted} FROM {source} ORDER BY {order}")

    def _held(self, columns: Sequence[Column], source: str, order: str) -> Iterator[tuple[Any, ...]]:
        """The rows of some columns, for a reader that keeps them all. Raises StudyError: their texts are too long."""
        if texts := [name for name, kind, _ in columns if kind == "TEXT"]:
            sizes = ", ".join(f'total(length("{self._sql[name]}"))' for name in texts)
            with closing(self._connect("ro")) as file, self._errors():
                size = sum(next(file.execute(f"SELECT {sizes} FROM {source}")))
            if size > _MOST_TEXTS:
                raise StudyError(f"{self.directory} has {size / 1e6:.0f} MB of texts, too many to be read at once")
        yield from self._each(self._selected(column.name for column in columns), source, order)

    def log_of(self, point: int, seed: int) -> Path:
        """The run directory of one of its runs; it is there only if its log was kept."""
        return self.logs / run_name(point, seed)

    @property
    def logs(self) -> Path:
        """Where the directories of its runs are whose logs were kept."""
        return self.directory.resolve() / _LOGS

    @property
    def folder(self) -> Path | None:
        return None if self.record.folder is None else Path(self.record.folder)

    @cached_property
    def points(self) -> list[StudyPoint]:
        """Every point. They are read once. Raises StudyError."""
        keys = [axis.key for axis in self.record.axes]
        rows = self._held([Column("point", "INTEGER"), *self._axes, Column("scenario", "TEXT")], "points", "point")
        return [StudyPoint(number, dict(zip(keys, values, strict=True)), text) for number, *values, text in rows]

    @property
    def rule(self) -> Rule | None:
        """When a point has enough seeds; None: no seed is added. Raises StudyError."""
        until = self.record.rules.until
        return parse_until(until, self.record.every_column) if until else None

    @property
    def seeds(self) -> list[int]:
        """All seeds that a point may have, in their order."""
        first, rules = self.record.seeds, self.record.rules
        return seed_sequence(first, rules.most_seeds) if rules.until else list(first)

    def needed_seeds(self, before: Mapping[int, int] | None = None) -> dict[int, int]:
        """How many seeds each point needs, as far as its rows show; none, where a border is looked for. `before`: what
        was needed earlier, which saves the way there. Raises StudyError: the study is damaged."""
        first = dict.fromkeys(range(len(self.points)), 0 if self.record.border else len(self.record.seeds))
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

    def _rows_of(self, rule: Rule) -> dict[int, dict[int, Row]]:
        by_point: dict[int, dict[int, Row]] = {}
        for row in self.rows(rule.columns):
            by_point.setdefault(row.point, {})[row.seed] = row
        return by_point

    @property
    def missing(self) -> int:
        """The number of runs without a row, among those that are known to be needed. Raises StudyError."""
        return 0 if self.record.border else sum(self.needed_seeds().values()) - len(self.finished_runs())

    def finished_runs(self) -> set[tuple[int, int]]:
        """(point, seed) of every run that has a row. Raises StudyError."""
        return set(self._each("point, seed", "runs", "point, seed"))

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows of runs, all or none. Raises StudyError."""
        names = [column.name for column in self.columns]
        values = [_flat(row, names) for row in rows]
        with ExitStack() as stack:
            file = self._writer or stack.enter_context(closing(self._connect("rw")))
            try:
                with file:
                    places = _places(len(self.columns))
                    file.executemany(f"INSERT INTO runs VALUES ({places}) ON CONFLICT DO NOTHING", values)
            except (OSError, sqlite3.Error) as error:
                broken = StudyError(
                    f"cannot write the study {self.directory}: {error}; what was written before stays, and the study "
                    "can be gone on with"
                )
                broken.status = 3  # nothing else should have been asked for
                raise broken from None

    def rows(self, numbers: Sequence[str] = (), *, checks: bool = False, details: bool = False) -> Iterator[Row]:
        """All rows one by one, ordered by point and seed, so that their order does not tell who ran them. Whether a row
        passed is what the check of the study says, if it has one. `checks`: whether they have the verdicts of the
        checks. `details`: whether they have the key, the reason, the digest, and who made them. Raises StudyError: the
        study is damaged, or holds more than a study writes."""
        names = self.record.checks if checks else []
        passed_by = f"{CHECK}{self.record.check}" if self.record.check else "passed"
        wanted = ["point", "seed", "status", passed_by, *(_DETAILS if details else ())]
        wanted += [f"{part}.{name}" for name in names for part in ("check", "value", "margin")]
        first, second = len(wanted) - 3 * len(names), len(wanted)
        wanted += numbers
        for values in self._each(self._selected(wanted), "runs", "point, seed"):
            point, seed, status, passed = values[:4]
            row = Row(point=point, seed=seed, status=status, passed=None if passed is None else bool(passed))
            if details:
                row.key, row.reason, row.digest, row.version, row.cores = values[4] or "", values[5] or "", *values[6:9]
            if names:
                row.checks = {
                    name: CheckRow(bool(values[k]), values[k + 1], values[k + 2])
                    for name, k in zip(names, range(first, second, 3), strict=True)
                    if values[k] is not None
                }
            if numbers:
                pairs = zip(numbers, values[second:], strict=True)
                row.numbers = {name: value for name, value in pairs if value is not None}
            yield row

    def _selected(self, names: Iterable[str]) -> str:
        return ", ".join(f'"{self._sql[name]}"' for name in names)

    def frame(self) -> pd.DataFrame:
        """All rows as a pandas DataFrame; `attrs["units"]` has the unit of each column. Raises StudyError."""
        import numpy as np
        import pandas as pd

        point, seed, key, *others = self.columns
        columns = [key, point, seed, *self._axes, *others]
        rows = self._held(columns, "runs JOIN points USING (point)", "point, seed")
        types = [
            np.int64 if name in ("point", "seed") else float if kind == "REAL" else object for name, kind, _ in columns
        ]
        chunks: list[list[Any]] = [[np.array([], of)] for of in types]
        while some := list(islice(rows, _CHUNK)):
            for chunk, of, values in zip(chunks, types, zip(*some, strict=True), strict=True):
                chunk.append(np.array(values, of))
        data: dict[str, Any] = {}
        for column, chunk, of in zip(columns, chunks, types, strict=True):
            found = np.concatenate(chunk)
            chunk.clear()
            if column.kind == "INTEGER" and of is object:
                truths = [None if value is None else bool(value) for value in found]
                found = np.array(truths, object if None in truths else bool)
            data[column.name] = found.tolist() if column.kind == "TEXT" else found
        frame = pd.DataFrame(data, columns=[column.name for column in columns])
        frame.attrs["units"] = {column.name: column.unit for column in columns if column.unit}
        return frame


def _flat(row: Row, names: Sequence[str]) -> list[Any]:
    values: dict[str, Any] = {
        "key": row.key, "point": row.point, "seed": row.seed, "status": row.status, "reason": row.reason,
        "passed": row.passed, "digest": row.digest, "version": row.version, "cores": row.cores, **row.numbers,
    }  # fmt: skip
    for name, check in row.checks.items():
        values |= {f"check.{name}": check.passed, f"value.{name}": check.value, f"margin.{name}": check.margin}
    return [values.get(name) for name in names]


def cell(axis: AxisRecord, value: AxisValue) -> float | str | None:
    """A value as a table has it: a number in the axis' unit, or a word."""
    return value.text if axis.unit is None else value.number


def _rename(part: Path, directory: Path) -> bool:
    """Give a directory its name, unless something has that name. Another program may do the same at this moment."""
    try:
        if directory.exists():
            return False
        part.rename(directory)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            return False
        raise
    return True


@contextmanager
def _no_larger(file: Path) -> Iterator[None]:
    """Let no file become larger than this one is. A journal says how long the file was before, and may be anybody's."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def _places(count: int) -> str:
    return ", ".join(["?"] * count)
