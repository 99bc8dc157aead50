"""Where a link's trace comes from: a file beside the scenario, or the scenario itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fleet.scenario.sections.data_files import DataFileError, read_beside
from fleet.scenario.sections.trace_table import MOST_ROWS, TraceTable, bare_cell, read_cells, read_csv
from netem.whole_file import read_file

MOST_BYTES = 10_000_000
INSIDE = "in the scenario"  # the name of a trace that has no file


class Traces:
    """The traces that a scenario names, each read once."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._known: dict[str, TraceTable] = {}

    def __getitem__(self, text: str) -> TraceTable:
        """As `load_trace`."""
        if text not in self._known:
            self._known[text] = load_trace(text, self._folder)
        return self._known[text]


def load_trace(text: str, folder: Path | None = None) -> TraceTable:
    """The trace that a scenario names, from `folder` (the scenario's) or the current directory.

    Args:
        text: the path of a file that ends in `.csv` or `.parquet`, or CSV with a line break.

    Raises:
        DataFileError: there is no such file, it cannot be read, or it has mistakes, each with its line.
    """
    if "\n" in text:
        return read_csv(text, INSIDE)
    if not text.endswith((".csv", ".parquet")):
        raise DataFileError("trace", text[:80] or '""', ["expected a file that ends in .csv or .parquet"])
    return read_beside("trace", text, folder, read_trace, most_shown=80)


def read_trace(path: Path) -> TraceTable:
    """The trace in a file.

    Raises:
        FileNotFoundError: there is none.
        DataFileError: as `load_trace`.
    """
    try:
        if path.suffix == ".parquet":
            return _read_parquet(path)
        return read_csv(read_file(path, MOST_BYTES).decode("utf-8"), str(path))
    except FileNotFoundError:
        raise
    except UnicodeDecodeError as error:
        raise DataFileError("trace", str(path), [f"not UTF-8 text (byte {error.start})"]) from None
    except (OSError, ValueError) as error:  # ValueError: the name has a null byte
        raise DataFileError("trace", str(path), [getattr(error, "strerror", None) or str(error)]) from None


def _read_parquet(path: Path) -> TraceTable:
    """A column's unit stands behind its name, as in CSV, or in its metadata, as `fleet export` writes it."""
    try:
        import pyarrow as pa

        from fleet.bounded_parquet import Most, read_columns
    except ImportError:
        raise DataFileError("trace", str(path), ["Parquet needs pyarrow: pip install 'uuv-fleet[parquet]'"]) from None

    def choose(schema: pa.Schema) -> list[str]:
        names: list[str] = schema.names
        if len(set(names)) < len(names):
            raise ValueError("two columns have one name")
        return names

    try:
        found = read_columns(path, Most(MOST_ROWS, MOST_BYTES, "a trace may"), choose)
        headings = [_heading(field) for field in found.schema]
        columns = [[bare_cell(value) for value in column.to_pylist()] for column in found.columns]
    except pa.ArrowException as error:
        raise DataFileError("trace", str(path), [f"{error!s:.200}"]) from None
    rows = ((f"row {number}", cells) for number, cells in enumerate(zip(*columns, strict=True), start=1))
    return read_cells(headings, rows, str(path))


def _heading(field: Any) -> str:
    unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
    return f"{field.name} [{unit}]" if unit and "[" not in field.name else field.name
