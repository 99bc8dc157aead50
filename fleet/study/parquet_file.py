"""The tables of a study as Parquet files. A study may come from anybody: its size is known before it is unpacked."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fleet.study.errors import StudyError
from fleet.study.pages import unpacked_bytes
from netem.whole_file import open_file

MOST_ROWS = 100_000  # of a file
MOST_BYTES = 200_000_000  # of a file: packed, unpacked, and in memory, where a word that stands once counts in each row
_MOST_GROUPS = 1000
_MOST_ABOUT = 4_000_000  # bytes at the end of a file that say what is in it
TEXT = pa.string()


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
    try:
        return _read(path, schema, schema.names if columns is None else columns)
    except FileNotFoundError:
        raise StudyError(f"{path} is missing") from None
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StudyError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error!s:.200}") from None


def _read(path: Path, schema: pa.Schema, columns: list[str]) -> pa.Table:
    with open_file(path) as file:
        size = file.seek(0, os.SEEK_END)
        _bound(path, size, MOST_BYTES, "bytes")
        file.seek(max(0, size - 8))
        about_size, mark = int.from_bytes(file.read(4), "little"), file.read(4)
        if mark != b"PAR1":
            raise ValueError("it is no Parquet file, or is cut off")
        _bound(path, about_size, _MOST_ABOUT, "bytes that say what is in it")
        file.seek(0)
        limits = {"thrift_string_size_limit": _MOST_ABOUT, "thrift_container_size_limit": _MOST_ABOUT}
        about = pq.ParquetFile(file, **limits).metadata
        _bound(path, about.num_row_groups, _MOST_GROUPS, "groups of rows")
        _bound(path, about.num_rows, MOST_ROWS, "rows")
        found = about.schema.to_arrow_schema() if about.num_columns == len(schema) else pa.schema([])
        types = dict(zip(found.names, found.types, strict=True))
        if len(types) < len(schema) or any(types.get(name) != schema.field(name).type for name in columns):
            raise StudyError(f"{path} has other columns than study.json says, which are {len(schema)}")
        unpacked = 0
        for k in range(about.num_row_groups):
            group = about.row_group(k)
            for column in range(about.num_columns):
                chunk = group.column(column)
                if chunk.num_values != group.num_rows or chunk.file_path:
                    raise StudyError(f"{path} is damaged: a column has other rows than it says")
                if any(f"{chunk.path_in_schema}.".startswith(f"{name}.") for name in columns):  # as Arrow chooses
                    unpacked += unpacked_bytes(file, chunk)
                    _bound(path, unpacked, MOST_BYTES, "bytes, unpacked")
        texts = [name for name in columns if schema.field(name).type == TEXT]
        packed = pq.ParquetFile(file, read_dictionary=texts, pre_buffer=False, **limits).read(
            columns, use_threads=False
        )
        packed.validate(full=True)  # texts are UTF-8, and stand in their dictionary
    if packed.num_rows != about.num_rows:
        raise StudyError(f"{path} is damaged: it has {packed.num_rows} rows, and says that it has {about.num_rows}")
    _bound(path, sum(map(_text_bytes, packed.columns)), MOST_BYTES, "bytes of texts")
    return packed.select(columns).cast(pa.schema([schema.field(name) for name in columns]))


def _text_bytes(column: pa.ChunkedArray) -> int:
    """What its texts take when each stands where it belongs."""
    total = 0
    if pa.types.is_dictionary(column.type):
        for chunk in column.chunks:
            lengths = pc.cast(pc.binary_length(chunk.dictionary), pa.int64())
            total += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    return total


def _bound(path: Path, found: int, most: int, what: str) -> None:
    if not 0 <= found <= most:
        raise StudyError(f"{path} holds {found} {what}, more than a study writes: {most} at most")
