"""Thrift's compact protocol, as far as Parquet files use it: bytes of a stranger in, numbers, texts and lists out.

https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

from __future__ import annotations

from typing import TypeAlias

Value: TypeAlias = "int | bytes | list[Value] | Fields | None"
Fields: TypeAlias = dict[int, Value]  # of a struct, by number

_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_MOST_DEPTH = 12  # its length bounds the rest: each value takes a byte at least


class ThriftReader:
    """Reads one struct; `at` is the place behind it."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def struct(self, depth: int = 0) -> Fields:
        """The fields of a struct. None stands for a number that is not whole.

        Raises:
            ValueError: it is cut off, too deep, has a field of an unknown kind, or says something twice.
        """
        if depth > _MOST_DEPTH:
            raise ValueError("a struct in it is too deep")
        found: Fields = {}
        field = 0
        while byte := self._byte():
            field = field + (byte >> 4) if byte >> 4 else self._signed()
            kind = byte & 0x0F
            value = int(kind == _TRUE) if kind in (_TRUE, _FALSE) else self._value(kind, depth)
            if found.setdefault(field, value) != value:
                raise ValueError("a struct in it says something twice")
        return found

    def _value(self, kind: int, depth: int) -> Value:
        if kind in (_I16, _I32, _I64):
            return self._signed()
        if kind == _STRUCT:
            return self.struct(depth + 1)
        if kind in (_LIST, _SET):
            head = self._byte()
            length = self._whole() if head >> 4 == 15 else head >> 4
            return [self._value(head & 0x0F, depth) for _ in range(length)]
        if kind == _BINARY:
            return self._take(self._whole())
        if kind in (_TRUE, _FALSE, _BYTE):  # in a list a truth value is a byte
            return self._byte()
        if kind == _DOUBLE:
            self._take(8)
            return None
        raise ValueError("a struct in it has a field of an unknown kind")

    def _take(self, length: int) -> bytes:
        if length > len(self._data) - self.at:
            raise ValueError("a struct in it is cut off")
        self.at += length
        return self._data[self.at - length : self.at]

    def _byte(self) -> int:
        return self._take(1)[0]

    def _whole(self) -> int:
        """A number without a sign, seven bits a byte."""
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise ValueError("a number in it is too long")

    def _signed(self) -> int:
        value = self._whole()
        return (value >> 1) ^ -(value & 1)
