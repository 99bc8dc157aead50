"""How many bytes the pages of a Parquet file unpack to, as the headers of the pages say.

The end of a file says it as well, but a reader unpacks what the headers say: of a file by a stranger the two may
differ. A header is a struct of Thrift's compact protocol.
"""

from __future__ import annotations

from typing import IO

import pyarrow.parquet as pq

_MOST_HEADER = 64_000  # bytes of a page's header; it has statistics with the least and the largest value
_MOST_DEPTH = 8
_UNPACKED, _PACKED = 2, 3  # fields of PageHeader
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)


def unpacked_bytes(file: IO[bytes], chunk: pq.ColumnChunkMetaData) -> int:
    """The sizes of all pages of a column chunk together, unpacked.

    Raises:
        ValueError: the headers are damaged.
        OSError: the file cannot be read.
    """
    starts = [chunk.data_page_offset, chunk.dictionary_page_offset if chunk.has_dictionary_page else None]
    at = min((start for start in starts if start is not None and start > 0), default=None)
    if at is None:
        if chunk.num_values:
            raise ValueError("a column has values and no page")
        return 0
    end = at + chunk.total_compressed_size
    total = 0
    while at < end:
        file.seek(at)
        header = _Header(file.read(min(_MOST_HEADER, end - at)))
        sizes = header.sizes()
        total += sizes[_UNPACKED]
        at += header.at + sizes[_PACKED]
    if at != end:
        raise ValueError("its pages are longer than it says")
    return total


class _Header:
    """A reader of one page header."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def sizes(self) -> dict[int, int]:
        """The numbers among its fields."""
        found = self._struct(0)
        if any(found.get(field, -1) < 0 for field in (_UNPACKED, _PACKED)):
            raise ValueError("the header of a page has no sizes")
        return found

    def _byte(self) -> int:
        if self.at >= len(self._data):
            raise ValueError("the header of a page is cut off")
        self.at += 1
        return self._data[self.at - 1]

    def _whole(self) -> int:
        """A number without a sign, seven bits a byte."""
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise ValueError("a number in the header of a page is too long")

    def _signed(self) -> int:
        value = self._whole()
        return (value >> 1) ^ -(value & 1)

    def _struct(self, depth: int) -> dict[int, int]:
        if depth > _MOST_DEPTH:
            raise ValueError("the header of a page is too deep")
        found: dict[int, int] = {}
        field = 0
        while byte := self._byte():
            field = field + (byte >> 4) if byte >> 4 else self._signed()
            value = self._value(byte & 0x0F, depth)
            if value is not None and found.setdefault(field, value) != value:
                raise ValueError("the header of a page says something twice")
        return found

    def _value(self, kind: int, depth: int) -> int | None:
        """Read a field, and return it if it is a whole number."""
        if kind in (_TRUE, _FALSE):
            return None
        if kind in (_I16, _I32, _I64):
            return self._signed()
        if kind == _STRUCT:
            self._struct(depth + 1)
        elif kind in (_BYTE, _DOUBLE, _BINARY):
            length = 1 if kind == _BYTE else 8 if kind == _DOUBLE else self._whole()
            self.at += length
        else:  # lists, sets and maps are in no header of a page
            raise ValueError("the header of a page has a field of an unknown kind")
        return None
