"""A Parquet file's description of its columns, and the number of bytes that their pages unpack to by the pages'
headers.

The end of a file says the size as well, but a reader unpacks what the headers say: of a file by a stranger the two may
differ. Columns are read here and not by pyarrow, because pyarrow 26 ends the process on some damaged ones
(`RowGroupMetaData.column`, "level histogram size mismatch").
"""

from __future__ import annotations

from typing import IO, NamedTuple

from fleet.thrift_compact import Fields, ThriftReader, Value

_MOST_HEADER = 64_000  # bytes of a page's header; it has statistics with the least and the largest value
_UNPACKED, _PACKED = 2, 3  # fields of PageHeader


class ColumnChunk(NamedTuple):
    """The pages of a column in one group of rows."""

    path: str  # names, with a dot between each two
    values: int
    size: int  # bytes of its pages, packed
    start: int | None  # of its first page in the file; None: it has none


def column_chunks(about: bytes) -> list[list[ColumnChunk]]:
    """The column chunks of each group of rows.

    Args:
        about: a FileMetaData, which stands at the end of a file.

    Raises:
        ValueError: it is damaged, or says that a column is in another file.
    """
    return [[_chunk(column) for column in _list(_fields(group), 1)] for group in _list(ThriftReader(about).struct(), 4)]


def unpacked_bytes(file: IO[bytes], chunk: ColumnChunk) -> int:
    """The sizes of all pages of a column chunk together, unpacked.

    Raises:
        ValueError: the headers are damaged.
        OSError: the file cannot be read.
    """
    if chunk.start is None:
        if chunk.values:
            raise ValueError("a column has values and no page")
        return 0
    at, end = chunk.start, chunk.start + chunk.size
    total = 0
    while at < end:
        file.seek(at)
        reader = ThriftReader(file.read(min(_MOST_HEADER, end - at)))
        header = reader.struct()
        total += _number(header, _UNPACKED)
        at += reader.at + _number(header, _PACKED)
    if at != end:
        raise ValueError("its pages are longer than it says")
    return total


def _chunk(column: Value) -> ColumnChunk:
    fields = _fields(column)
    if fields.get(1):
        raise ValueError("a column is in another file")
    about = _fields(fields.get(3))
    path = b".".join(name for name in _list(about, 3) if isinstance(name, bytes))
    starts = [place for field in (9, 11) if isinstance(place := about.get(field), int) and place > 0]
    return ColumnChunk(path.decode(), _number(about, 5), _number(about, 7), min(starts, default=None))


def _fields(value: Value) -> Fields:
    if not isinstance(value, dict):
        raise ValueError("a struct in it is missing")
    return value


def _list(fields: Fields, field: int) -> list[Value]:
    value = fields.get(field, [])
    if not isinstance(value, list):
        raise ValueError("a list in it is none")
    return value


def _number(fields: Fields, field: int) -> int:
    """A number that is there, and not below 0."""
    value = fields.get(field)
    if not isinstance(value, int) or value < 0:
        raise ValueError("a size in it is missing or below 0")
    return value
