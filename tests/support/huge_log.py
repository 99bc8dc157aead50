"""Huge logs and bombs, for tests.

`python tests/support/huge_log.py KIND OUT [--chunks N] [--mib M]`

| kind | what |
|---|---|
| run | a run's own messages, again and again, later each time; whole, valid, compresses as runs do |
| same | the same, of one short message per topic: compresses to almost nothing, and holds the most messages |
| blobs | one topic of somebody else's, a message per chunk |
| bomb | one chunk that says it is small and unpacks to 4 GiB (with `--mib`: to so much) |
| honest-bomb | the same, but it says how much it unpacks to |
"""

from __future__ import annotations

import argparse
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.opcode import Opcode

from fleet.mcap.records import MAGIC

HEAD, MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")


def record(opcode: int, body: bytes) -> bytes:
    """One MCAP record."""
    return HEAD.pack(opcode, len(body)) + body


def text(value: str | bytes) -> bytes:
    """A string with its length."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def chunk(content: bytes, first: int, last: int, *, size: int | None = None, compression: str = "zstd") -> bytes:
    """A chunk record of a content, or of what is compressed already if its size is given."""
    if size is None:
        packed = zstandard.ZstdCompressor(level=1).compress(content) if compression else content
    else:
        packed = content
    crc = zlib.crc32(content) if size is None else 0
    head = struct.pack("<QQQI", first, last, len(content) if size is None else size, crc)
    return record(Opcode.CHUNK, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def tail(messages: int, first: int, last: int, at: int) -> bytes:
    """The end of a file whose data section ends at a byte: the count of messages, and the footer."""
    end = record(Opcode.DATA_END, bytes(4))
    counts = struct.pack("<QHIIIIQQI", messages, 0, 0, 0, 0, 0, first, last, 0)
    summary = record(Opcode.STATISTICS, counts)
    footer = HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", at + len(end), 0)
    return end + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC


def channel(number: int, topic: str, schema: int = 0, encoding: str = "") -> bytes:
    """A channel record without metadata."""
    return record(Opcode.CHANNEL, struct.pack("<HH", number, schema) + text(topic) + text(encoding) + text(b""))


def write(path: Path, chunks: Iterator[tuple[bytes, int, int, int]], before: bytes = b"") -> Path:
    """A whole file of chunks, each given with its messages and its first and last time."""
    with path.open("wb") as file:
        file.write(MAGIC + record(Opcode.HEADER, text("") + text("uuv-fleet")) + before)
        total, begin, end = 0, 1 << 63, 0
        for packed, messages, first, last in chunks:
            file.write(packed)
            total, begin, end = total + messages, min(begin, first), max(end, last)
        file.write(tail(total, begin, end, file.tell()))
    return path


def bomb(path: Path, size: int, *, says: int) -> Path:
    """One chunk of `size` zero bytes that states another size; its frame states none."""
    compressor = zstandard.ZstdCompressor(level=19, write_content_size=False).compressobj()
    packed = b"".join([*(compressor.compress(bytes(1 << 20)) for _ in range(size >> 20)), compressor.flush()])
    return write(path, iter([(chunk(packed, 0, 10**9, size=says), 1, 0, 10**9)]))


def blobs(path: Path, chunks: int, size: int) -> Path:
    """A topic without schema, whose messages fill a chunk each."""
    first = channel(1, "camera")

    def each() -> Iterator[tuple[bytes, int, int, int]]:
        for n in range(chunks):
            body = MESSAGE.pack(1, n, n * 10**9, n * 10**9) + bytes([n % 251]) * (size - 4096)
            at = n * 10**9
            yield chunk((first if n == 0 else b"") + record(Opcode.MESSAGE, body), at, at), 1, at, at

    return write(path, each())


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The records of a log's data section, those of its chunks in their place."""
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        body = data[at + HEAD.size : at + HEAD.size + length]
        at += HEAD.size + length
        if opcode == Opcode.DATA_END:
            return
        if opcode == Opcode.CHUNK:
            yield from records(zstandard.decompress(body[28 + 8 + 8 :]))  # behind times, size, CRC, "zstd", length
        else:
            yield opcode, body


def again(path: Path, source: Path, chunks: int, size: int, *, same: bool) -> Path:
    """The messages of a log, repeated until there are so many chunks of so many bytes, each time later."""
    before, messages, declared = b"", [], b""
    for opcode, body in records(source.read_bytes()[len(MAGIC) :]):
        if opcode == Opcode.MESSAGE:
            messages.append(body)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            declared += record(opcode, body)
        elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            before += record(opcode, body)
    if same:
        kept: dict[bytes, bytes] = {}
        for body in messages:
            kept.setdefault(body[:2], body)
        messages = [body for body in kept.values() if len(body) < 200]
    span = max(MESSAGE.unpack_from(body)[2] for body in messages) + 10_000_000
    once = b"".join(record(Opcode.MESSAGE, body) for body in messages)
    sizes = np.array([HEAD.size + len(body) for body in messages])
    starts = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    fields: Any = np.frombuffer(once, np.uint8)
    times = starts[:, None] + HEAD.size + 6 + np.arange(16)
    sequences = starts[:, None] + HEAD.size + 2 + np.arange(4)
    ticks = span // 10_000_000

    def shifted(n: int) -> bytes:
        data = fields.copy()
        data[times] = (fields[times].view("<u8") + np.uint64(n * span)).view(np.uint8)
        data[sequences] = (fields[sequences].view("<u4") + np.uint32(n * ticks)).view(np.uint8)
        return bytes(data.tobytes())

    def each() -> Iterator[tuple[bytes, int, int, int]]:
        n = 0
        for k in range(chunks):
            parts, held, first = [declared if k == 0 else b""], len(declared), n
            while held + len(once) <= size or n == first:
                parts.append(shifted(n))
                held += len(once)
                n += 1
            yield chunk(b"".join(parts), first * span, n * span), (n - first) * len(messages), first * span, n * span

    return write(path, each(), before)


def main(arguments: list[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["run", "same", "blobs", "bomb", "honest-bomb"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--chunks", type=int, default=60)
    parser.add_argument("--mib", type=int, help="of each chunk, unpacked; by default 64, of a bomb 4096")
    parser.add_argument("--source", type=Path, default=Path("runs/latest/run.mcap"), help="the run that is repeated")
    a = parser.parse_args(arguments)
    size = (a.mib or (4096 if "bomb" in a.kind else 64)) << 20
    match a.kind:
        case "bomb" | "honest-bomb":
            bomb(a.out, size, says=size if a.kind == "honest-bomb" else 1 << 20)
        case "blobs":
            blobs(a.out, a.chunks, size)
        case _:
            again(a.out, a.source, a.chunks, size, same=a.kind == "same")
    print(f"{a.out}: {a.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
