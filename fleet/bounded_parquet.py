"""Parquet files that may come from anybody: what a file holds is known, and bounded, before it is unpacked."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fleet.parquet_pages import column_chunks, unpacked_bytes
from netem.private_file import open_file

TEXT = pa.string()
_MOST_GROUPS = 1000
_MOST_ABOUT = 4_000_000  # bytes at the end of a file that say what is in it


class Most(NamedTuple):
    """The limits of a file's content, and the reason for them."""

    rows: int
    bytes: int  # packed, unpacked, and in memory, where a word that stands once counts in each row
    why: str  # as in `more than a study writes`


def read_columns(path: Path, most: Most, choose: Callable[[pa.Schema], Sequence[str]]) -> pa.Table:
    """Some columns of a file; texts may be dictionaries.

    Args:
        choose: the names of the columns to read, which the file has once each, given all of them.

    Raises:
        OSError: it is no regular file, or cannot be read.
        ValueError, pa.ArrowException: it is damaged, or holds more than it may.
    """
    with open_file(path) as file:
        size = file.seek(0, os.SEEK_END)
        _bound(size, most.bytes, "bytes", most)
        file.seek(max(0, size - 8))
        about_size, mark = int.from_bytes(file.read(4), "little"), file.read(4)
        if mark != b"PAR1":
            raise ValueError("it is no Parquet file, or is cut off")
        _bound(about_size, min(_MOST_ABOUT, size), "bytes that say what is in it", most)
        file.seek(0)
        limits = {"thrift_string_size_limit": _MOST_ABOUT, "thrift_container_size_limit": _MOST_ABOUT}
        about = pq.ParquetFile(file, **limits).metadata
        _bound(about.num_row_groups, _MOST_GROUPS, "groups of rows", most)
        file.seek(size - 8 - about_size)
        groups = column_chunks(file.read(about_size))
        if [len(chunks) for chunks in groups] != [about.num_columns] * about.num_row_groups:
            raise ValueError("it is damaged: a group of rows has other columns than it says")
        _bound(about.num_rows, most.rows, "rows", most)
        schema = about.schema.to_arrow_schema()
        if about.num_columns != len(schema):
            schema = pa.schema([])  # columns within columns
        columns = list(choose(schema))
        unpacked = 0
        for k, chunks in enumerate(groups):
            for chunk in chunks:
                if chunk.values != about.row_group(k).num_rows:
                    raise ValueError("it is damaged: a column has other rows than it says")
                if any(f"{chunk.path}.".startswith(f"{name}.") for name in columns):  # as Arrow chooses
                    unpacked += unpacked_bytes(file, chunk)
                    _bound(unpacked, most.bytes, "bytes, unpacked", most)
        texts = [name for name in columns if schema.field(name).type == TEXT]
        packed = pq.ParquetFile(file, read_dictionary=texts, pre_buffer=False, **limits).read(
            columns, use_threads=False
        )
        packed.validate(full=True)  # texts are UTF-8, and stand in their dictionary
    if packed.num_rows != about.num_rows:
        raise ValueError(f"it is damaged: it has {packed.num_rows} rows, and says that it has {about.num_rows}")
    _bound(sum(map(_text_bytes, packed.columns)), most.bytes, "bytes of texts", most)
    return packed.select(columns)


def _text_bytes(column: pa.ChunkedArray) -> int:
    """The bytes that the texts of a column take without a dictionary."""
    total = 0
    if pa.types.is_dictionary(column.type):
        for chunk in column.chunks:
            lengths = pc.cast(pc.binary_length(chunk.dictionary), pa.int64())
            total += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    return total


def _bound(found: int, most: int, what: str, limits: Most) -> None:
    if not 0 <= found <= most:
        raise ValueError(f"it holds {found} {what}, more than {limits.why}: {most} at most")
