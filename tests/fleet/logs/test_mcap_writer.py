"""Our writer of MCAP files writes what the library's writer writes, byte for byte."""

from __future__ import annotations

import io
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Attachment
from mcap.writer import CompressionType, Writer

from fleet.logs.mcap_writer import CHUNK_BYTES, McapWriter

TIMES = st.integers(0, 2**63 - 1)
NAMES = st.text(max_size=12)
DATA = st.one_of(st.binary(max_size=200), st.integers(0, CHUNK_BYTES + 100).map(bytes))
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("message"), st.integers(0, 3), TIMES, TIMES, st.integers(0, 2**32 - 1), DATA),
        st.tuples(st.just("schema"), NAMES, NAMES, st.binary(max_size=20)),
        st.tuples(st.just("channel"), NAMES, NAMES, st.dictionaries(NAMES, NAMES, max_size=2)),
        st.tuples(st.just("attachment"), TIMES, TIMES, NAMES, NAMES, st.binary(max_size=50)),
        st.tuples(st.just("metadata"), NAMES, st.dictionaries(NAMES, NAMES, max_size=2)),
        st.tuples(st.just("flush")),
    ),
    max_size=25,
)


def by_library(steps: list[tuple[Any, ...]]) -> bytes:
    target = io.BytesIO()
    writer = Writer(target, compression=CompressionType.ZSTD)
    writer.start("profile", "library")
    schemas = channels = 0
    for kind, *values in steps:
        if kind == "message" and channels:
            channel, log_ns, publish_ns, sequence, data = values
            writer.add_message(channel % channels + 1, log_ns, data, publish_ns, sequence)
        elif kind == "schema":
            schemas = writer.register_schema(*values)
        elif kind == "channel":
            topic, encoding, metadata = values
            channels = writer.register_channel(topic, encoding, schemas, metadata)
        elif kind == "attachment":
            writer.add_attachment(*values)
        elif kind == "metadata":
            writer.add_metadata(*values)
        elif kind == "flush":
            writer.flush()
    writer.finish()
    return target.getvalue()


def by_us(steps: list[tuple[Any, ...]]) -> bytes:
    target = io.BytesIO()
    writer = McapWriter(target, "profile", "library")
    schemas = channels = 0
    for kind, *values in steps:
        if kind == "message" and channels:
            channel, log_ns, publish_ns, sequence, data = values
            writer.message(channel % channels + 1, log_ns, publish_ns, sequence, data)
        elif kind == "schema":
            schemas = writer.schema(*values)
        elif kind == "channel":
            topic, encoding, metadata = values
            channels = writer.channel(topic, encoding, schemas, metadata)
        elif kind == "attachment":
            writer.attachment(Attachment(*values))
        elif kind == "metadata":
            writer.metadata(*values)
        elif kind == "flush":
            writer.flush()
    writer.finish()
    return target.getvalue()


@settings(max_examples=300, deadline=None)
@given(STEPS)
def test_the_same_bytes_as_the_library(steps: list[tuple[Any, ...]]) -> None:
    assert by_us(steps) == by_library(steps)


def test_many_messages_end_chunks_where_the_library_ends_them() -> None:
    """And the library's reader, which checks every CRC, gets them all in their order."""
    declared: list[tuple[Any, ...]] = [
        ("schema", "s", "protobuf", b"x"),
        *[("channel", f"t{i}", "e", {}) for i in (1, 2, 3)],
    ]
    messages = [("message", i % 3, i * 10, i * 10 - i % 7, i, bytes(1 + i % 250)) for i in range(1, 20_000)]
    written = by_us(declared + messages)
    assert written == by_library(declared + messages)
    reader = make_reader(io.BytesIO(written), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.chunk_count > 2
    read = [(m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in reader.iter_messages()]
    assert read == [tuple(m[2:]) for m in messages]
