"""MCAP files as other programs may write them: every option of the library's writer, and what readers are to ignore."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from struct import Struct
from typing import Any

import lz4.frame
import zstandard
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

HEAD = Struct("<BQ")
MAGIC = 8  # bytes
TIMES = st.integers(0, 20) | st.integers(0, 2**63 - 1)
_FIXED = (Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER)  # the specification says that these are never extended
_PACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes, "lz4": lz4.frame.compress, "zstd": lambda data: zstandard.ZstdCompressor().compress(data),
}  # fmt: skip
_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes, "lz4": lz4.frame.decompress, "zstd": lambda data: zstandard.ZstdDecompressor().decompress(data),
}  # fmt: skip


@st.composite
def written(draw: st.DrawFn) -> bytes:
    """A file of the library's writer."""
    flags = [IndexType.ATTACHMENT, IndexType.CHUNK, IndexType.MESSAGE, IndexType.METADATA]
    indexes = IndexType.NONE
    for flag in draw(st.sets(st.sampled_from(flags))):
        indexes |= flag
    switches = ["repeat_channels", "repeat_schemas", "use_chunking", "use_statistics", "use_summary_offsets",
                "enable_crcs", "enable_data_crcs"]  # fmt: skip
    options: dict[str, Any] = {name: draw(st.booleans()) for name in switches}
    file = BytesIO()
    writer = Writer(
        file, draw(st.sampled_from([1, 60, 1 << 20])), draw(st.sampled_from(CompressionType)), indexes, **options
    )
    writer.start(draw(st.sampled_from(["", "ros2"])), "somebody")
    channels: list[int] = []
    for number in range(draw(st.integers(0, 12))):
        kind = draw(st.sampled_from(["message", "message", "message", "channel", "attachment", "metadata"]))
        if kind == "attachment":
            writer.add_attachment(draw(TIMES), draw(TIMES), f"a{number}", "text/plain", draw(st.binary(max_size=9)))
        elif kind == "metadata":
            writer.add_metadata(f"m{number}", draw(st.dictionaries(st.text(max_size=3), st.text(max_size=3))))
        elif kind == "channel" or not channels:
            schema = draw(st.just(0) | st.builds(writer.register_schema, st.just("S"), st.just(""), st.just(b"any")))
            channels.append(writer.register_channel(draw(st.sampled_from(["a", "/b", "c d"])), "json", schema))
        else:
            writer.add_message(
                draw(st.sampled_from(channels)), draw(TIMES), draw(st.binary(max_size=9)), draw(TIMES), number
            )
    writer.finish()
    return file.getvalue()


def split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Records that follow on one another: the opcode and the content of each."""
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        yield opcode, data[at + HEAD.size :][:length]
        at += HEAD.size + length


@st.composite
def extended(draw: st.DrawFn, data: bytes) -> bytes:
    """The same file with records of unknown kinds in any place, and bytes behind the known fields of records."""

    def more(records: bytes) -> bytes:
        out = b""
        for opcode, body in split(records):
            if opcode == Opcode.CHUNK:
                body = _chunk(body, more)
            elif opcode == Opcode.FOOTER:
                body = body[:16] + bytes(4)  # 0: no CRC
            if opcode not in _FIXED:
                body += draw(st.just(b"") | st.binary(max_size=20))
            if out and draw(st.booleans()):
                unknown = draw(st.binary(max_size=9))
                out += HEAD.pack(draw(st.integers(0x10, 0xFF)), len(unknown)) + unknown
            out += HEAD.pack(opcode, len(body)) + body
        return out

    return data[:MAGIC] + more(data[MAGIC:-MAGIC]) + data[-MAGIC:]


def _chunk(body: bytes, more: Callable[[bytes], bytes]) -> bytes:
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    data = more(_UNPACK[chunk.compression](chunk.data))
    chunk.data, chunk.uncompressed_size = _PACK[chunk.compression](data), len(data)
    chunk.uncompressed_crc = chunk.uncompressed_crc and zlib.crc32(data)
    builder = RecordBuilder()
    chunk.write(builder)
    return builder.end()[HEAD.size :]


def by_library(data: bytes) -> list[Message]:
    """The messages of a file in its order, as the library reads them."""
    return [record for record in StreamReader(BytesIO(data)).records if isinstance(record, Message)]


# A file, and its messages. The library reads them before the file is extended: longer records in chunks mislead it.
ANY_MCAP = written().flatmap(
    lambda data: st.tuples(st.just(data) | extended(data), st.just(by_library(data)))
)  # fmt: skip
