"""The digest of a log: SHA-256 over its ordered messages, whatever the chunks and the compression of the file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from struct import Struct

import numpy as np

from fleet.mcap.records import Block

_TIMES = Struct("<QQII").pack
_STAMP = np.dtype([("log", "<u8"), ("publish", "<u8"), ("sequence", "<u4"), ("length", "<u4")])  # for many at once
_MOST_PARTS = 3000  # the parts of 1000 messages: hashing them in one piece costs less than one by one
_MOST_BYTES = 64 * 1024  # bytes of batches that are hashed in one piece


class Digest:
    """Takes the messages of a log in their order."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._parts: list[bytes] = []
        self._held = 0  # bytes of batches among the parts

    def add(self, topic: bytes, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Take one message: `topic` in UTF-8, both times in ns of simulated time."""
        parts = self._parts
        parts += (topic, _TIMES(log_ns, publish_ns, sequence, len(data)), data)
        if len(parts) >= _MOST_PARTS:
            self._take()

    def add_batch(self, digested: bytes) -> None:
        """Take messages that are put together already: of each what `add` takes, in that order."""
        self._parts.append(digested)
        self._held += len(digested)
        if self._held >= _MOST_BYTES:
            self._take()

    def add_block(self, block: Block, topics: Mapping[int, bytes]) -> None:
        """Take the messages of a block; `topics` are the topics of its channels, in UTF-8."""
        stamps = np.empty(len(block), _STAMP)
        stamps["log"], stamps["publish"], stamps["sequence"] = block.log_ns, block.publish_ns, block.sequence
        stamps["length"] = block.end - block.begin
        packed, data, size = stamps.tobytes(), block.data, _STAMP.itemsize
        parts = self._parts
        columns = zip(block.channel.tolist(), block.begin.tolist(), block.end.tolist(), strict=True)
        for at, (channel, begin, end) in zip(range(0, len(packed), size), columns, strict=True):
            parts += (topics[channel], packed[at : at + size], data[begin:end])
        self._take()

    def hexdigest(self) -> str:
        """The digest of all messages so far, in hexadecimal."""
        self._take()
        return self._hash.hexdigest()

    def _take(self) -> None:
        self._hash.update(b"".join(self._parts))
        self._parts.clear()
        self._held = 0
