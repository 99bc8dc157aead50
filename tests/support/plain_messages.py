"""Messages of doubles encoded one by one, and a copy of what is logged."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

from fleet.logs.schemas import MessageField, Schema, head

Entry = tuple[str, int, int, int, bytes]  # topic, log time, publish time, sequence, data


def encoded(columns: Iterable[MessageField], values: Sequence[float]) -> bytes:
    """A message of doubles field by field, zeros too, as all of the log's are."""
    data, rest = b"", list(values)
    for number, column in enumerate(columns, start=1):
        width = column.width or 1
        data += head(number, column.width or None) + struct.pack(f"<{width}d", *rest[:width])
        del rest[:width]
    assert not rest
    return data


class Copy:
    """A tap of the log writer that keeps all messages."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self._topics: dict[int, str] = {}

    def channel(self, number: int, topic: str, schema: Schema) -> None:
        self._topics[number] = topic

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        self.entries.append((self._topics[channel], log_ns, publish_ns, sequence, data))

    def flush(self) -> None:
        pass
