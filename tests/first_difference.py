"""Where two logs part: the first event that differs, with both sides decoded, for people to read."""

from __future__ import annotations

from itertools import zip_longest
from pathlib import Path
from typing import Any

from google.protobuf.text_format import MessageToString
from mcap_protobuf.decoder import DecoderFactory

from fleet.reader import LogReader, Record


def assert_same_bytes(a: Path, b: Path) -> None:
    """Fail with the first differing event unless both files hold the same bytes."""
    if a.read_bytes() != b.read_bytes():
        raise AssertionError(f"{a} and {b} differ: {first_difference(a, b)}")


def first_difference(a: Path, b: Path) -> str:
    """The first message that is not the same in both logs, else the first other thing that is not; "" if none."""
    readers = LogReader(a), LogReader(b)
    for number, (left, right) in enumerate(zip_longest(*readers)):
        if left != right:
            return f"event {number}\n  a: {_show(readers[0], left)}\n  b: {_show(readers[1], right)}"
    for what in ("metadata", "attachments", "channels", "schemas", "missing"):
        left, right = (getattr(reader, what) for reader in readers)
        if left != right:
            return f"{what}\n  a: {left!r:.2000}\n  b: {right!r:.2000}"
    bytes_a, bytes_b = a.read_bytes(), b.read_bytes()
    if bytes_a == bytes_b:
        return ""
    offset = next((n for n, (x, y) in enumerate(zip(bytes_a, bytes_b, strict=False)) if x != y), None)
    return f"only the framing, from byte {offset} on" if offset is not None else "one file is longer"


def decode(reader: LogReader, record: Record) -> Any:
    """The protobuf message of a record that `reader` has just yielded."""
    channel = next(c for c in reader.channels.values() if c.topic == record.topic)
    decoder = DecoderFactory().decoder_for("protobuf", reader.schemas[channel.schema_id])
    assert decoder is not None, f"{record.topic} is not protobuf"
    return decoder(record.data)


def _show(reader: LogReader, record: Record | None) -> str:
    if record is None:
        return f"the log ends here{f' ({reader.missing})' if reader.missing else ''}"
    tick_ns = int(reader.metadata.get("run", {}).get("tick_ns", "0"))
    tick = f"tick {record.log_ns / tick_ns:g}" if tick_ns else f"{record.log_ns} ns"
    values = MessageToString(decode(reader, record), as_one_line=True)
    return f"{record.topic}, {tick}, sent {record.publish_ns} ns, seq {record.sequence}: {values}"
