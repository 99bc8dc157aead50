"""`fleet export`: a log as tables, one file per topic, for what reads CSV, Parquet or NetCDF.

In CSV the units stand in the header, so a table explains itself wherever a user copies it to. In Parquet the names are
bare; unit and meaning are metadata of the column, and of the table as pandas reads them. In NetCDF they are CF's
attributes. `export.json` states for each table what it holds, where it came from and what was missing. A topic that is
no table is left out, which `export.json` states as well.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from io import StringIO
from itertools import chain, count
from math import inf
from pathlib import Path
from typing import IO, Any

import numpy as np

from fleet.errors import FleetError
from fleet.logs.columns import objects
from fleet.logs.dataset import EXTRA, dataset, frame_attributes
from fleet.logs.open_log import Log
from fleet.logs.table import TableColumn, columns, fits, require
from fleet.logs.topic import Topic
from fleet.mcap.reader import LogReader, OnProgress
from fleet.mcap.records import Array, Block
from netem.whole_file import part_of

INDEX = "export.json"
_LONGEST_NAME = 200  # bytes of a topic in the name of its file, which may have 255 with its suffix
MOST_OPEN = 200  # tables that are written at once: Parquet keeps its files open
_LARGE = 1 << 20  # bytes of a cell
_HELD = 12 << 20  # bytes of messages that wait to be written


def export(log: Log, folder: Path, form: str, *, force: bool = False, share: OnProgress = lambda _: None) -> list[Path]:
    """Write every topic that holds a message and fits a table into a folder, as `csv`, `parquet` or `netcdf`; returns
    the files. The log is read again, and written as it is read. A table gets its name when all are written.

    Raises FleetError if a file is in the way and not to be replaced (`force`), the place cannot be written, a package
    is not installed, or a table is too large for NetCDF; LogReadError if a topic's messages are not what the log says
    they are.
    """
    suffix, sheet_of, name, packages, extra = _FORMS[form]
    require(name, packages, extra)
    topics = [name for name in log if fits(log[name])]
    left_out = [name for name in log if len(log[name]) and name not in topics]
    paths = {name: folder / f"{plain}.{suffix}" for name, plain in file_names(topics).items()}
    there = [path.name for path in [*paths.values(), folder / INDEX] if path.exists()]
    if there and not force:
        raise FleetError(f"{folder} already holds {there[0]}; choose another place, or replace it with --force")
    parts = {path: part_of(path) for path in [*paths.values(), folder / INDEX]}
    sheets = {name: sheet_of(log[name], parts[path], log.run) for name, path in paths.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for some in batched(sheets.values(), MOST_OPEN, log.most_held if form == "netcdf" else inf):
            _stream(log.path, some, share)
            if again := [sheet for sheet in some if sheet.begin_again()]:
                _stream(log.path, again, share)
        index = {
            "log": str(log.path),
            "run": log.run,
            "missing": log.missing,
            "left_out": {name: f"a {log[name].schema} holds lists of messages" for name in left_out},
            "tables": {path.name: sheets[name].about() for name, path in paths.items()},
        }
        parts[folder / INDEX].write_text(json.dumps(index, indent=2) + "\n", "utf-8")
        for path, part in parts.items():
            part.replace(path)
    except OSError as error:
        raise FleetError(f"cannot write to {folder}: {error.strerror}") from error
    finally:
        for part in parts.values():
            with suppress(OSError):
                part.unlink(missing_ok=True)
    return [*paths.values(), folder / INDEX]


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """A name for the file of each topic, without a suffix: `uuv-1-state`. Topics that differ only in characters that a
    file name cannot have, or in upper and lower case, get a number behind it.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for topic in topics:
        plain = "".join(c if c.isalnum() or c in "-_." else "-" for c in topic.strip("/"))
        plain = plain.lstrip(".-").encode()[:_LONGEST_NAME].decode("utf-8", "ignore") or "topic"
        numbered = (f"{plain}-{n}" for n in count(2))
        name = next(name for name in chain([plain], numbered) if name.casefold() not in taken)
        taken.add(name.casefold())
        found[topic] = name
    return found


def _stream(path: Path, sheets: Iterable[Sheet], share: OnProgress) -> None:
    by_topic = {sheet.topic.name: sheet for sheet in sheets}
    reader = LogReader(path, share)
    held = 0
    for block in reader.blocks():
        for number, some in block.by_channel():
            sheet = by_topic.get(reader.channels[number].topic)
            if sheet is not None:
                held += sheet.add(some)
        if held > _HELD:
            for sheet in by_topic.values():
                sheet.flush()
            held = 0
    for sheet in by_topic.values():
        sheet.flush()
        sheet.close()


class Sheet:
    """One table that is written in parts, into a file with another name."""

    def __init__(self, topic: Topic, part: Path, run: Mapping[str, str]) -> None:
        self.topic, self.part = topic, part
        self._run = run
        self._mixed: set[str] = set()  # vectors that are not always as long, so that their parts are no columns
        self._restart()

    def _restart(self) -> None:
        self._shapes: dict[str, tuple[int, ...]] | None = None
        self._wrong = False
        self._rows = 0
        self._headings: dict[str, list[str]] = {}
        self.topic.drop()

    def add(self, block: Block) -> int:
        """Take more messages; how many bytes they hold."""
        before = self.topic.cost
        self.topic.add(block)
        return self.topic.cost - before

    def flush(self) -> None:
        topic = self.topic
        if not topic.cost:
            return
        shapes = {name: topic[name].shape[1:] if name not in self._mixed else () for name in topic.fields}
        if self._shapes is not None and shapes != self._shapes:
            self._wrong = True
            self._mixed |= {name for name, shape in shapes.items() if shape != self._shapes[name]}
        if not self._wrong:
            found = columns(topic, self._mixed)
            if self._shapes is None:
                self._headings = {column.name: [column.unit, column.meaning] for column in found}
                self._begin(found)
            self._shapes = shapes
            self._rows += len(topic)
            self._write(found)
        topic.drop()

    def begin_again(self) -> bool:
        """Whether the table must be written again: a vector turned out to have no fixed length."""
        if self._wrong:
            self._restart()
            return True
        return False

    def about(self) -> dict[str, Any]:
        """The content of the table."""
        return {
            "topic": self.topic.name, "schema": self.topic.schema, "rows": self._rows, "columns": self._headings,
        }  # fmt: skip

    def _begin(self, columns: list[TableColumn]) -> None:
        """Nothing is written before the first rows."""

    def _write(self, columns: list[TableColumn]) -> None:
        raise NotImplementedError

    def close(self) -> None:
        """Nothing follows."""


class CsvSheet(Sheet):
    """Text, opened anew for each part: there may be more tables than files may be open."""

    def _begin(self, columns: list[TableColumn]) -> None:
        with self.part.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow([column.heading for column in columns])

    def _write(self, columns: list[TableColumn]) -> None:
        with self.part.open("a", encoding="utf-8", newline="") as file:
            if any(map(_has_large, columns)):
                for row in zip(*(column.values.tolist() for column in columns), strict=True):
                    _write_large(file, row)
                return
            # Python's shortest decimals: they read back to the same doubles.
            csv.writer(file, lineterminator="\n").writerows(
                zip(*(_plain(column.values) for column in columns), strict=True)
            )


class ParquetSheet(Sheet):
    """Parquet, a group of rows for each part."""

    def _begin(self, columns: list[TableColumn]) -> None:
        import pyarrow
        import pyarrow.parquet

        self._schema = pyarrow.schema(
            [
                pyarrow.field(
                    column.name,
                    pyarrow.array(_arrow(column.values)).type,
                    metadata={"unit": column.unit, "meaning": column.meaning},
                )
                for column in columns
            ],
            metadata={"PANDAS_ATTRS": json.dumps(frame_attributes(columns))},
        )  # pandas.read_parquet gives it as .attrs
        self._writer: Any = pyarrow.parquet.ParquetWriter(self.part, self._schema)

    def _write(self, columns: list[TableColumn]) -> None:
        import pyarrow

        try:
            arrays = [
                pyarrow.array(_arrow(column.values), type=field.type)
                for column, field in zip(columns, self._schema, strict=True)
            ]
        except pyarrow.ArrowException as error:
            raise FleetError(f"{self.topic.name}: a column holds values of different kinds: {error}") from None
        self._writer.write_table(pyarrow.Table.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        if self._shapes is not None:
            self._writer.close()


class NetcdfSheet(Sheet):
    """NetCDF-3, the form that everything reads; it is written when all of it is there."""

    def _restart(self) -> None:
        if self.topic.size > self.topic.most_held:
            raise FleetError(
                f"{self.topic.name} is too large for NetCDF ({self.topic.size / 1e6:.0f} MB): use --parquet, or choose "
                "others with --topics"
            )
        super()._restart()
        self._parts: list[list[TableColumn]] = []

    def _write(self, columns: list[TableColumn]) -> None:
        self._parts.append(columns)

    def close(self) -> None:
        if not self._parts:
            return
        whole = [
            column._replace(values=_to_netcdf(np.concatenate([part[k].values for part in self._parts])))
            for k, column in enumerate(self._parts[0])
        ]
        found = dataset(self.topic, whole, self._run)
        found.to_netcdf(self.part, engine="scipy", format="NETCDF3_64BIT")
        self._parts = []


_FORMS: dict[str, tuple[str, type[Sheet], str, tuple[str, ...], str]] = {
    "csv": ("csv", CsvSheet, "CSV", (), ""),
    "parquet": ("parquet", ParquetSheet, "Parquet", ("pyarrow",), "parquet"),
    "netcdf": ("nc", NetcdfSheet, "NetCDF", ("xarray", "scipy"), EXTRA),
}


def batched(sheets: Iterable[Sheet], most: int, most_bytes: float = inf) -> Iterator[list[Sheet]]:
    """Group the sheets into batches of bounded number and size; a batch is never empty."""
    some: list[Sheet] = []
    size = 0
    for sheet in sheets:
        if some and (len(some) == most or size + sheet.topic.size > most_bytes):
            yield some
            some, size = [], 0
        some.append(sheet)
        size += sheet.topic.size
    if some:
        yield some


def _has_large(column: TableColumn) -> bool:
    return column.values.dtype == object and any(isinstance(v, bytes) and len(v) > _LARGE for v in column.values)


def _write_large(file: IO[str], row: Iterable[Any]) -> None:
    """A row cell by cell: the library would put it together with four bytes for each character."""
    for n, value in enumerate(row):
        file.write("," if n else "")
        if isinstance(value, bytes):
            for at in range(0, len(value), _LARGE):
                file.write(value[at : at + _LARGE].hex())
        else:
            cell = StringIO()
            csv.writer(cell, lineterminator="").writerow([value, ""])
            file.write(cell.getvalue()[:-1])
    file.write("\n")


def _plain(values: Array) -> Iterable[Any]:
    if values.dtype == object:
        return [value.hex() if isinstance(value, bytes) else value for value in values]
    found: list[Any] = values.tolist()
    return found


def _to_netcdf(values: Array) -> Array:
    """The same in a type of NetCDF-3, which has no integers of 64 bits."""
    if values.dtype == np.int64 and np.any(np.abs(values) > np.iinfo(np.int32).max):
        return values.astype(np.float64)
    if values.dtype == object and not all(isinstance(value, (str, bytes)) for value in values):
        return objects(map(str, values))
    return values


def _arrow(values: Array) -> Any:
    if values.dtype != object:
        return values
    plain = all(isinstance(value, (str, bytes, int, float)) for value in values)
    return list(values) if plain else [str(value) for value in values]
