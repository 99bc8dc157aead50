"""Our writer of MCAP files writes what the library's writer writes, byte for byte."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from fleet.mcap.batch import HEAD, MESSAGE, STAMP_BYTES, Batch
from fleet.mcap.writer import CHUNK_BYTES, McapWriter

TIMES = st.integers(0, 2**63 - 1)
NAMES = st.text(max_size=12)
DATA = st.one_of(st.binary(max_size=200), st.integers(0, CHUNK_BYTES + 100).map(bytes))
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("message"), st.integers(0, 3), TIMES, TIMES, st.integers(0, 2**32 - 1), DATA),
        st.tuples(st.just("batch"), TIMES, st.integers(0, 2**32 - 1), st.lists(st.tuples(st.integers(0, 3), DATA))),
        st.tuples(st.just("schema"), NAMES, NAMES, st.binary(max_size=20)),
        st.tuples(st.just("channel"), NAMES, NAMES, st.dictionaries(NAMES, NAMES, max_size=2)),
        st.tuples(st.just("attachment"), TIMES, TIMES, NAMES, NAMES, st.binary(max_size=50)),
        st.tuples(st.just("metadata"), NAMES, st.dictionaries(NAMES, NAMES, max_size=2)),
        st.tuples(st.just("flush")),
    ),
    max_size=25,
)


class Library:
    """The library's writer, with the methods of ours."""

    def __init__(self, target: io.BytesIO, profile: str, library: str) -> None:
        self._writer = Writer(target, compression=CompressionType.ZSTD)
        self._writer.start(profile, library)
        self.schema = self._writer.register_schema
        self.channel = self._writer.register_channel
        self.metadata = self._writer.add_metadata
        self.flush = self._writer.flush
        self.finish = self._writer.finish

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        self._writer.add_message(channel, log_ns, data, publish_ns, sequence)

    def batch(self, batch: Batch) -> None:
        for message in batch.messages():
            self.message(*message)

    def attachment(self, a: Attachment) -> None:
        self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)


def batch_of(at_ns: int, sequence: int, messages: list[tuple[int, bytes]]) -> Batch:
    """Messages of one time, by channel and data."""
    records = [
        HEAD.pack(MESSAGE, STAMP_BYTES + len(data), channel, sequence, at_ns, at_ns) + data
        for channel, data in messages
    ]
    channels = np.array([channel for channel, _ in messages], np.uint16)
    bounds = np.cumsum([0, *map(len, records)])
    joined = np.frombuffer(b"".join(records), np.uint8)
    return Batch(at_ns, sequence, channels, bounds, joined, np.empty(0, np.uint8))


def written(make: Callable[..., Any], steps: list[tuple[Any, ...]]) -> bytes:
    target = io.BytesIO()
    writer = make(target, "profile", "library")
    schemas = channels = 0
    for kind, *values in steps:
        if kind == "message":
            if channels:
                channel, *rest = values
                writer.message(channel % channels + 1, *rest)
        elif kind == "batch":
            if channels:
                at_ns, sequence, messages = values
                writer.batch(batch_of(at_ns, sequence, [(n % channels + 1, data) for n, data in messages]))
        elif kind == "schema":
            schemas = writer.schema(*values)
        elif kind == "channel":
            topic, encoding, metadata = values
            channels = writer.channel(topic, encoding, schemas, metadata)
        elif kind == "attachment":
            writer.attachment(Attachment(*values))
        else:
            getattr(writer, kind)(*values)
    writer.finish()
    return target.getvalue()


@given(STEPS)
def test_the_same_bytes_as_the_library(steps: list[tuple[Any, ...]]) -> None:
    assert written(McapWriter, steps) == written(Library, steps)


def test_what_a_batch_gives_back() -> None:
    messages = [(3, b"abc"), (1, b""), (3, b"d")]
    assert [*batch_of(5, 6, messages).messages()] == [(channel, 5, 5, 6, data) for channel, data in messages]
    assert [*batch_of(5, 6, []).messages()] == []


def test_many_messages_end_chunks_where_the_library_ends_them() -> None:
    """And the library's reader, which checks every CRC, gets them all in their order."""
    declared: list[tuple[Any, ...]] = [
        ("schema", "s", "protobuf", b"x"),
        *[("channel", f"t{i}", "e", {}) for i in (1, 2, 3)],
    ]
    messages = [("message", i % 3, i * 10, i * 10 - i % 7, i, bytes(1 + i % 250)) for i in range(1, 20_000)]
    ours = written(McapWriter, declared + messages)
    assert ours == written(Library, declared + messages)
    reader = make_reader(io.BytesIO(ours), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.chunk_count > 2
    read = [(m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in reader.iter_messages()]
    assert read == [tuple(m[2:]) for m in messages]


def test_batches_end_chunks_where_the_library_ends_them() -> None:
    """Also where a batch is longer than a chunk."""
    declared: list[tuple[Any, ...]] = [("channel", f"t{i}", "e", {}) for i in range(65)]
    batches = [("batch", i, i, [(n, bytes(1 + (i * n) % 900)) for n in range(i % 1500)]) for i in range(0, 6000, 450)]
    long = ("batch", 7, 7, [(n, bytes(40_000)) for n in range(64)])
    ours = written(McapWriter, [*declared, *batches, long, *batches])
    assert ours == written(Library, [*declared, *batches, long, *batches])
    summary = make_reader(io.BytesIO(ours)).get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.chunk_count > 4
