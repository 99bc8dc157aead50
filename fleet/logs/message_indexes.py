"""The message indexes behind a chunk of an MCAP file: where in the chunk they say that messages are."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct

import numpy as np
from mcap.opcode import Opcode

from fleet.logs.records import Array

_HEAD = Struct("<BQHI")  # how a message index begins: opcode, length of the rest, channel, bytes of its entries
_WINDOW = 1 << 18  # bytes of message indexes that are looked at together
_ALIKE = 16  # so many indexes of one length in a row are probably the beginning of more


def read_indexes(read: Callable[[int, int], bytes], at: int, most: int) -> tuple[int, Array | None]:
    """Find the sound message indexes from a byte on; a chunk has one per channel.

    Args:
        read: returns the bytes of the file from a place on: as many as asked for, fewer at the end of the file.
        at: where the first index begins.
        most: the largest number of places that is returned.

    Returns:
        Where the last sound index ends, and the places of the messages in the chunk; None if there are more than
        `most`.
    """
    index, head, unpack = int(Opcode.MESSAGE_INDEX), _HEAD.size, _HEAD.unpack_from
    parts: list[Array] = []
    count = 0
    while True:
        window = read(at, _WINDOW)
        begin, last = 0, len(window) - head
        begins: list[int] = []  # of indexes since the last run of equal ones
        runs: list[Array] = []
        opcode, size, alike = index, 0, 0
        while begin <= last:
            opcode, length, _, entries = unpack(window, begin)
            end = begin + head + entries
            if opcode != index or length != entries + 6 or entries % 16 or end > len(window):
                break
            begins.append(begin)
            size, alike = end - begin, alike + 1 if end - begin == size else 0
            begin = end
            if alike == _ALIKE:
                more = _alike(window, begin, size)
                runs += [np.array(begins), np.arange(begin, begin + more * size, size)]
                begins, begin, alike = [], begin + more * size, 0
        at += begin
        if begin and count <= most:
            parts.append(_entries(window, np.concatenate([*runs, np.array([*begins, begin])])))
            count += len(parts[-1])
        if not begin or len(window) < _WINDOW or opcode != index:
            return at, np.concatenate(parts) if parts and count <= most else None


def _alike(window: bytes, begin: int, size: int) -> int:
    """How many indexes follow at a byte that begin as the one before it, but for the channel.

    A log of a thousand vehicles has ten million indexes of one message each.
    """
    whole = (len(window) - begin) // size
    rows = np.frombuffer(window, np.uint8, (whole + 1) * size, begin - size).reshape(-1, size)
    same = rows[1:, : _HEAD.size] == rows[0, : _HEAD.size]
    same[:, 9:11] = True  # the channel
    fits = same.all(axis=1)
    return whole if fits.all() else int(fits.argmin())


def _entries(indexes: bytes, bounds: Array) -> Array:
    """The places that message indexes state, one behind the other; each entry is a time and a place."""
    counts = (np.diff(bounds) - _HEAD.size) // 16
    first = np.repeat(bounds[:-1] + _HEAD.size - 16 * (np.cumsum(counts) - counts), counts)
    at = first + 16 * np.arange(len(first)) + 8
    return np.ndarray((max(0, len(indexes) - 7),), "<u8", indexes, strides=(1,))[at]
