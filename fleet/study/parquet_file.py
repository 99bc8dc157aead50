"""The tables of a study as Parquet files. A study may come from anybody: its size is known before it is unpacked."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fleet.bounded_parquet import TEXT as TEXT
from fleet.bounded_parquet import Most, read_columns
from fleet.study.errors import StudyError

MOST_ROWS = 100_000  # of a file
MOST_BYTES = 200_000_000  # of a file
_MOST = Most(MOST_ROWS, MOST_BYTES, "a study writes")


def write_table(path: Path, table: pa.Table) -> None:
    """Make a file that is there as a whole or not at all. Raises OSError."""
    part = path.with_suffix(".part")
    pq.write_table(table, part, compression="zstd")
    os.replace(part, path)


def read_table(path: Path, schema: pa.Schema, columns: list[str] | None = None) -> pa.Table:
    """The rows of a file.

    Args:
        schema: of the whole file.
        columns: which are read; None: all.

    Raises:
        StudyError: it is no regular file, has other columns, holds more than a study writes, or is damaged.
    """
    names = schema.names if columns is None else columns

    def choose(found: pa.Schema) -> list[str]:
        types = dict(zip(found.names, found.types, strict=True))
        if len(types) != len(schema) or any(types.get(name) != schema.field(name).type for name in names):
            raise StudyError(f"{path} has other columns than study.json says, which are {len(schema)}")
        return names

    try:
        found = read_columns(path, _MOST, choose)
        return found.cast(pa.schema([schema.field(name) for name in names]))
    except FileNotFoundError:
        raise StudyError(f"{path} is missing") from None
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StudyError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error!s:.200}") from None
