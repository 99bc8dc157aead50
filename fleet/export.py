"""`fleet export`: a log as tables, one file per topic, for what reads CSV or Parquet.

A table's first column is `t [s]`, the time at which the message was logged; every other one is a field of the log, a
vector's components each with their index: `tau_0 [N]`. In CSV the units stand in the header, so that a table explains
itself wherever it is copied to; in Parquet the names are bare, and unit and meaning are metadata of the column.
`export.json` beside the tables says what each holds, where it came from and what was missing. A topic whose messages
hold lists of messages (`transforms`, `scene`) is no table: it is left out, and `export.json` says so.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fleet.arrays import Array, Log, Topic
from fleet.errors import FleetError

INDEX = "export.json"


class ExportError(FleetError):
    """The tables cannot be written."""


class Column(NamedTuple):
    """One column of a table."""

    name: str
    unit: str
    meaning: str
    values: Array  # (samples,)

    @property
    def heading(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def columns(topic: Topic) -> list[Column]:
    """The table of a topic; the time comes first."""
    found = [Column("t", "s", "when the message was logged, in simulated time", topic.t)]
    units, meanings = topic.units, topic.meanings
    for name in topic.fields:
        values = topic[name]
        if values.ndim == 1:
            found.append(Column(name, units[name], meanings[name], values))
            continue
        parts = [part.strip() for part in units[name].split(",")]
        if len(parts) != values.shape[1]:
            parts = [units[name]] * values.shape[1]
        found += [
            Column(f"{name}_{k}", unit, meanings[name], np.ascontiguousarray(values[:, k]))
            for k, unit in enumerate(parts)
        ]
    return found


def fits(topic: Topic) -> bool:
    """Whether a topic has a message and each is a row of values."""
    return bool(len(topic)) and not topic.nested


def export(
    log: Log, folder: Path, form: str, *, force: bool = False, tell: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Write every topic that holds a message and fits a table into a folder, made if need be; returns the files.

    Args:
        form: `csv` or `parquet`.
        force: replace files of the same names.
        tell: told each topic before it is written.

    Raises:
        ExportError: something is in the way, the place cannot be written, or pyarrow is not installed.
        LogReadError: a topic's messages are not what the log says they are.
    """
    write = {"csv": _write_csv, "parquet": _write_parquet}[form]
    if form == "parquet" and find_spec("pyarrow") is None:
        raise ExportError(
            "Parquet needs pyarrow, which is not installed: pip install 'uuv-fleet[parquet]', or use --csv"
        )
    topics = [name for name in log if fits(log[name])]
    left_out = [name for name in log if len(log[name]) and name not in topics]
    paths = {name: folder / f"{_file_name(name)}.{form}" for name in topics}
    if len(set(paths.values())) < len(paths):
        raise ExportError(f"topics of {log.path} differ only in characters that a file name cannot have")
    there = [path.name for path in [*paths.values(), folder / INDEX] if path.exists()]
    if there and not force:
        raise ExportError(f"{folder} already holds {there[0]}; choose another place, or replace it with --force")
    tables: dict[str, Any] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in paths.items():
            tell(name)
            table = columns(log[name])
            write(path, table)
            tables[path.name] = {
                "topic": name,
                "schema": log[name].schema,
                "rows": len(log[name]),
                "columns": {column.name: [column.unit, column.meaning] for column in table},
            }
        index = {
            "log": str(log.path),
            "run": log.run,
            "missing": log.missing,
            "left_out": {name: f"a {log[name].schema} holds lists of messages" for name in left_out},
            "tables": tables,
        }
        (folder / INDEX).write_text(json.dumps(index, indent=2) + "\n", "utf-8")
    except OSError as error:
        raise ExportError(f"cannot write to {folder}: {error.strerror}") from error
    return [*paths.values(), folder / INDEX]


def _file_name(topic: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in topic)


def _write_csv(path: Path, table: list[Column]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([column.heading for column in table])
        # Python's shortest decimals: they read back to the same doubles.
        writer.writerows(zip(*(_plain(column.values) for column in table), strict=True))


def _plain(values: Array) -> Iterable[Any]:
    if values.dtype == object:
        return [value.hex() if isinstance(value, bytes) else value for value in values]
    found: list[Any] = values.tolist()
    return found


def _write_parquet(path: Path, table: list[Column]) -> None:
    import pyarrow
    import pyarrow.parquet

    arrays = [pyarrow.array(_arrow(column.values)) for column in table]
    fields = [
        pyarrow.field(column.name, array.type, metadata={"unit": column.unit, "meaning": column.meaning})
        for column, array in zip(table, arrays, strict=True)
    ]
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields)), path)


def _arrow(values: Array) -> Any:
    if values.dtype != object:
        return values
    plain = all(isinstance(value, (str, bytes, int, float)) for value in values)
    return list(values) if plain else [str(value) for value in values]
