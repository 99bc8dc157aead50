"""Where two logs part, as the tests say it: `fleet diff` without its table."""

from __future__ import annotations

from itertools import zip_longest
from pathlib import Path
from typing import Any

from fleet.logs.decoder import Decoder
from fleet.logs.difference import besides_messages, difference, side
from fleet.mcap.reader import LogReader, Record


def assert_same_bytes(a: Path, b: Path) -> None:
    """Fail with the first differing message unless both files hold the same bytes."""
    if a.read_bytes() != b.read_bytes():
        raise AssertionError(f"{a} and {b} differ: {first_difference(a, b)}")


def first_difference(a: Path, b: Path) -> str:
    """The first message that is not the same in both logs, else the first other thing that is not; "" if none."""
    readers = LogReader(a), LogReader(b)
    for number, (left, right) in enumerate(zip_longest(*readers)):
        if left != right:
            return str(difference(number, side("a", readers[0], left), side("b", readers[1], right)))
    if others := besides_messages(*readers):
        return others[0]
    if readers[0].missing != readers[1].missing:
        return f"missing: {readers[0].missing!r} and {readers[1].missing!r}"
    return "" if a.read_bytes() == b.read_bytes() else "only the framing"


def decode(reader: LogReader, record: Record) -> Any:
    """The protobuf message of a record that `reader` has just yielded."""
    message = Decoder(reader).message(record)
    assert message is not None, f"{record.topic} is not protobuf"
    return message
