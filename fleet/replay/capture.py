"""`fleet record`: zenoh traffic of any kind into an MCAP file, as it comes.

One channel per key, zenoh encoding and kind, without a schema. The topic is the key; the channel's metadata hold
`zenoh.kind` (put, delete or attachment) and `zenoh.encoding`. `log_time` is when the recorder received the sample,
`publish_time` zenoh's timestamp if the sample has one, both ns since 1970; `sequence` numbers the samples from 0. A
sample with an attachment is two messages with the same sequence: the attachment, on a channel of that kind, then the
payload. So payloads stay what they are, and any viewer that knows their encoding reads them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, Protocol

from fleet.errors import FleetError
from fleet.mcap.traffic import ATTACHMENT, DELETE, ENCODING, KIND, PUT
from fleet.mcap.writer import CHUNK_BYTES, McapWriter
from fleet.terminal.status_line import StatusLine
from netem.limits import LOG_RECORD
from netem.wire.key_expression import matching
from netem.wire.open_bus import ZenohSample, sample_of

PROFILE = "zenoh"

# https://mcap.dev/spec/registry#message-encodings against zenoh's predefined encodings
_WELL_KNOWN = {
    "json": "application/json",
    "protobuf": "application/protobuf",
    "cbor": "application/cbor",
    "cdr": "application/cdr",
}
_OF_ZENOH = {zenoh: mcap for mcap, zenoh in _WELL_KNOWN.items()} | {"text/json": "json"}


def message_encoding(encoding: str) -> str:
    """MCAP's name of a zenoh encoding, or zenoh's own where MCAP has none, or where it would ask for a schema."""
    name = _OF_ZENOH.get(encoding.split(";")[0], encoding)
    return encoding if name in ("protobuf", "cdr") else name


def zenoh_encoding(name: str, schema: str) -> str:
    """Zenoh's encoding for a message encoding and the name of its schema: `application/protobuf;foxglove.Log`."""
    encoding = _WELL_KNOWN.get(name, name or "zenoh/bytes")
    return f"{encoding};{schema}" if schema and ";" not in encoding else encoding


FLUSH_NS = 1_000_000_000  # a recorder that is killed loses so much at most
POLL_S = 0.1
GONE_S = 1.0  # a connection that was lost is back sooner, if it comes back
MOST_QUEUED = 100_000  # samples; beyond that zenoh's thread waits, and with it the sender
MOST_CHANNELS = 65_535  # MCAP numbers them with 16 bits
MOST_BATCH = 1000
MOST_MESSAGE = LOG_RECORD.bytes - 2 * CHUNK_BYTES  # bytes; readers of logs take no chunk that is longer


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raises FleetError: the disk is full, or `path` cannot be written."""
    try:
        yield
    except OSError as error:
        raise FleetError(f"cannot write {path}: {error.strerror}") from None


class SampleWriter(Protocol):
    samples: int

    @property
    def size(self) -> int: ...
    def add(self, sample: ZenohSample, at_ns: int, /) -> None: ...
    def flush(self, now_ns: int, /) -> None: ...
    def close(self) -> None: ...


class SampleSource(Protocol):
    def subscribe(self, key: str, handler: Callable[[Any], None], /) -> object: ...


class TrafficWriter:
    """An MCAP file of samples. `close` writes the index; without it the file is cut but readable."""

    def __init__(self, path: Path, keys: Sequence[str]) -> None:
        """Raises FleetError: the file exists, or cannot be made."""
        self.path = path
        self.samples = 0
        self._channels: dict[tuple[str, str, str], int] = {}
        self._flushed_ns = 0
        if path.exists():
            raise FleetError(f"{path} exists already; choose another name with -o")
        with writing(path):
            self._file: IO[bytes] = path.open("xb")
            self._writer = McapWriter(self._file, PROFILE)
            self._writer.metadata("zenoh", {"keys": " ".join(keys)})

    @property
    def size(self) -> int:
        return self._file.tell() if not self._file.closed else self.path.stat().st_size

    def add(self, sample: ZenohSample, at_ns: int) -> None:
        """Append a sample that was received at `at_ns` [ns since 1970]. Raises FleetError: the disk is full, or there
        are more keys than a file can hold."""
        publish_ns = at_ns if sample.stamp_ns is None else sample.stamp_ns
        number = self.samples & 0xFFFFFFFF
        if sample.attachment is not None:
            channel = self._channel(sample.key, "", ATTACHMENT)
            self._put(channel, at_ns, sample.attachment, publish_ns, number)
        channel = self._channel(sample.key, sample.encoding, DELETE if sample.delete else PUT)
        self._put(channel, at_ns, sample.payload, publish_ns, number)
        self.samples += 1
        self.flush(at_ns)

    def flush(self, now_ns: int) -> None:
        """Write out what there is if a second has passed since the last time. Raises FleetError."""
        if now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            with writing(self.path):
                self._writer.flush()

    def close(self) -> None:
        """Write the index. Raises FleetError: the disk is full; what was flushed stays readable."""
        if not self._file.closed:
            with writing(self.path), self._file:
                self._writer.finish()

    def _channel(self, key: str, encoding: str, kind: str) -> int:
        found = self._channels.get((key, encoding, kind))
        if found is None:
            if len(self._channels) >= MOST_CHANNELS:
                raise FleetError(f"more than {MOST_CHANNELS} keys and encodings: one file holds no more of them")
            metadata = {KIND: kind} | ({ENCODING: encoding} if kind != ATTACHMENT else {})
            found = self._writer.channel(key, message_encoding(encoding), 0, metadata)
            self._channels[key, encoding, kind] = found
        return found

    def _put(self, channel: int, at_ns: int, data: bytes, publish_ns: int, number: int) -> None:
        with writing(self.path):
            self._writer.message(channel, at_ns, publish_ns, number, data)


class PublisherGone:
    """Whether a session has had no connection for `GONE_S`; to be called repeatedly."""

    def __init__(self, connected: Callable[[], bool]) -> None:
        self._connected = connected
        self._since: float | None = None

    def __call__(self) -> bool:
        now = time.monotonic()
        if self._connected():
            self._since = None
        elif self._since is None:
            self._since = now
        return self._since is not None and now - self._since >= GONE_S


class Recorder:
    """Writes what a session receives to a file, in the order of reception."""

    def __init__(self, bus: SampleSource, keys: Sequence[str]) -> None:
        """Begin to listen. Raises BusError: a key expression is none."""
        self._queue: SimpleQueue[tuple[int, Any]] = SimpleQueue()
        self._finished = False
        self.too_long = 0  # messages that are left out
        self._longest = 0, ""  # bytes and key of the longest one
        # Wall time that a correction of the system's clock cannot turn back.
        self._zero_ns = time.time_ns() - time.monotonic_ns()  # noqa: TID251 (the log of others is in wall time)
        for number, key in enumerate(keys):
            earlier = [matching(other) for other in keys[:number]]
            bus.subscribe(key, partial(self._receive_once, earlier) if earlier else self._receive)

    def _receive_once(self, earlier: Sequence[Callable[[str], bool]], received: Any) -> None:
        """Zenoh delivers a sample to each subscriber: if several keys include it, it is of the first one."""
        key = sample_of(received).key
        if not any(included(key) for included in earlier):
            self._receive(received)

    def _receive(self, received: Any) -> None:
        while self._queue.qsize() >= MOST_QUEUED and not self._finished:
            time.sleep(0.01)
        self._queue.put((self._zero_ns + time.monotonic_ns(), received))

    def record(
        self,
        writer: SampleWriter,
        duration_ns: int | None,
        line: StatusLine,
        interrupted: Callable[[], KeyboardInterrupt | None] = lambda: None,
        over: Callable[[], bool] | None = None,
    ) -> bool:
        """Record until the time is over, nothing more can come, or an exception ends it. `duration_ns`: wall time;
        None: without limit. `over`: asked when nothing came for a while, whether anything can. Returns whether that was
        the end. Raises FleetError: the file cannot be written any more; KeyboardInterrupt: the instance that
        `interrupted` returned; between two messages."""
        began = seen_ns = time.monotonic_ns()
        seen, rate = 0, 0.0
        end = None if duration_ns is None else began + duration_ns
        while True:
            if (interruption := interrupted()) is not None:
                raise interruption
            now = time.monotonic_ns()
            if end is not None and now >= end:
                return False
            if now - seen_ns >= FLUSH_NS:
                rate, seen, seen_ns = (writer.samples - seen) * 1e9 / (now - seen_ns), writer.samples, now
            if line.due():
                took = f"{(now - began) / 1e9:.0f} s  {writer.samples} messages, {rate:.0f} messages/s"
                line.show(f"{took}, {writer.size / 1e6:.2f} MB")
            try:
                self._add(writer, *self._queue.get(timeout=POLL_S if end is None else min(POLL_S, (end - now) / 1e9)))
            except Empty:
                if over is not None and over() and self._queue.empty():
                    return True
                writer.flush(self._zero_ns + time.monotonic_ns())
            self._drain(writer, MOST_BATCH)

    def finish(self, writer: SampleWriter) -> None:
        """Write what was received before now, and close the file. Raises FleetError."""
        try:
            self._drain(writer, self._queue.qsize())
        finally:
            self._finished = True  # a thread of zenoh that waits for room would keep the session from closing
            writer.close()

    def _drain(self, writer: SampleWriter, most: int) -> None:
        for _ in range(min(most, self._queue.qsize())):
            self._add(writer, *self._queue.get_nowait())

    def _add(self, writer: SampleWriter, at_ns: int, received: Any) -> None:
        sample = sample_of(received)
        length = max(len(sample.payload), len(sample.attachment or b""))
        if length > MOST_MESSAGE:
            self.too_long += 1
            self._longest = max(self._longest, (length, sample.key))
        else:
            writer.add(sample, at_ns)

    @property
    def left_out(self) -> str:
        """What was too long, in words; empty: nothing was."""
        length, key = self._longest
        what = f"the longest has {length / 1e6:.0f} MB, on {key:.100}; a log holds up to {MOST_MESSAGE / 1e6:.0f} MB"
        return f"messages left out: {self.too_long}, {what}" if self.too_long else ""
