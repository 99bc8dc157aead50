"""A live run's journal on zenoh: the recorder's messages go to a process of their own, which publishes them.

The run pays for a copy into a pipe and no more: the pipe is never waited for. When it is full, because the publisher
cannot keep up, whole ticks are left out and counted; the numbers in the stamps show subscribers what is missing. The
publisher's router is not the run's, so a subscriber cannot hold up, or even see, what moves the run: on the run's
router low-latency sending happens on the calling thread, and a slow reader would stall the world.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import subprocess
import time
from pathlib import Path
from struct import Struct
from typing import Any

from fleet.errors import FleetError
from fleet.logs.schemas import Schema
from fleet.processes.side_process import begin, end, line_of, pipe
from fleet.replay.observed import new_observed, write_observed

ENTRY = Struct("<HIQQQII")  # channel, sequence, log and publish time, places in log and topic, bytes that follow
LENGTH = Struct("<I")  # length of a batch
PIPE_BYTES = 1 << 20  # the most that Linux gives an ordinary user
BATCH_BYTES = 1 << 16
READY_S = 20.0
DRAIN_S = 10.0  # for the process to take and publish what it was given, which waits for no subscriber
CLOSE_S = 2.0  # for what is then still on the way to subscribers


class LivePublisher:
    """Publishes each message of a log writer; see `fleet.recorder.writer.Tap`. `open` starts the process."""

    def __init__(self, run: str, observe: Path, scenario: str, *, wait: bool = False) -> None:
        """Prepare; `open` starts the process. `observe`: file that holds, while the run lives, where and as which user
        to subscribe. `wait`: whether `wait_for_subscriber` will be called."""
        self.run = run
        self.wait = wait
        self.dropped = 0  # messages that the pipe had no room for
        self.published = 0  # while there was a subscriber, as the process reports at its end
        self.endpoint = ""
        self._observe = observe
        self._scenario = scenario
        self._channels: list[tuple[int, str, str]] = []
        self._schemas: dict[str, str] = {}
        self._units: dict[str, str] = {}
        self._batch: list[bytes] = []
        self._size = 0
        self._number = 0
        self._places: dict[int, int] = {}  # how many messages there were, by channel
        self._rest = b""  # the rest of a batch that is partly written
        self._gone = False
        self._process: subprocess.Popen[bytes] | None = None

    def channel(self, number: int, topic: str, schema: Schema) -> None:
        """There will be messages on this channel."""
        self._channels.append((number, topic, schema.name))
        self._places[number] = 0
        self._schemas[schema.name] = base64.b64encode(schema.descriptor_set).decode()
        self._units[schema.name] = schema.units

    def open(self) -> None:
        """Start the process and wait until it listens. Raises FleetError: it ended, or did not listen in time, or the
        way in cannot be written down."""
        observed = new_observed("", self.run)  # the process says where it listens
        values = {
            "run": observed.run,
            "user": observed.user,
            "password": observed.password,
            "scenario": self._scenario,
            "channels": self._channels,
            "schemas": self._schemas,
            "units": self._units,
            "wait": self.wait,
        }
        # The process ends with the pipe, also when we are killed.
        streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = process = begin("fleet.replay.publisher_process", **streams)
        try:
            pipe(process.stdin).write(json.dumps(values).encode() + b"\n")
            pipe(process.stdin).flush()
            answer = self._answer(READY_S)
        except OSError:
            answer = {}
        if "endpoint" not in answer:
            end(process, 0.0)
            why = answer.get("error", "the publisher did not start")
            raise FleetError(f"the journal cannot be published: {why}", status=3)
        self.endpoint = answer["endpoint"]
        descriptor = pipe(process.stdin).fileno()
        os.set_blocking(descriptor, False)
        with contextlib.suppress(OSError):  # where it may not be larger, it stays as it is
            fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        observed.endpoint = self.endpoint
        try:
            write_observed(self._observe, observed)
        except OSError as error:
            end(process, 0.0)
            raise FleetError(f"cannot write {self._observe}: {error.strerror}", status=3) from error

    def wait_for_subscriber(self) -> None:
        """Wait without limit until there is a subscriber to the journal or to a part of it. Raises FleetError: the
        process ended meanwhile."""
        if "heard" not in self._answer(None):
            why = "the publisher ended while it waited for a subscriber"
            raise FleetError(f"the journal cannot be published: {why}", status=3)

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        place = self._places[channel]
        self._batch.append(ENTRY.pack(channel, sequence, log_ns, publish_ns, self._number, place, len(data)))
        self._batch.append(data)
        self._places[channel] = place + 1
        self._number += 1
        self._size += ENTRY.size + len(data)
        if self._size >= BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand over what there is, or leave it out."""
        if not self._batch or self._process is None:
            return
        if self._rest and not self._write_rest():
            self.dropped += len(self._batch) // 2
        else:
            self._rest = LENGTH.pack(self._size) + b"".join(self._batch)
            self._write_rest()
        self._batch.clear()
        self._size = 0

    def _write_rest(self) -> bool:
        """Write as much as there is room for; whether that was all."""
        assert self._process is not None
        try:
            count = os.write(pipe(self._process.stdin).fileno(), self._rest)
        except BlockingIOError:
            return False
        except OSError:  # the publisher is gone; the run goes on without it
            self._gone = True
            return False
        self._rest = self._rest[count:]
        return not self._rest

    def _write_all(self, deadline: float) -> None:
        """Wait until the rest of the last batch is written, or it is too late."""
        assert self._process is not None
        while self._rest and not self._gone and not self._write_rest() and time.monotonic() < deadline:
            select.select([], [pipe(self._process.stdin)], [], 0.1)

    def close(self) -> None:
        """End the process, once it has published what it was given."""
        process = self._process
        self._observe.unlink(missing_ok=True)
        if process is None:
            return
        deadline = time.monotonic() + DRAIN_S
        self._write_all(deadline)  # otherwise there would be no room for what comes last
        self.flush()
        self._write_all(deadline)
        with contextlib.suppress(OSError):
            pipe(process.stdin).close()
        self.published = self._answer(max(CLOSE_S, deadline - time.monotonic())).get("published", 0)
        end(process, CLOSE_S)
        pipe(process.stdout).close()
        self._process = None

    def _answer(self, limit_s: float | None) -> dict[str, Any]:
        assert self._process is not None
        try:
            values = json.loads(line_of(self._process, limit_s))
        except ValueError:
            return {}
        return values if isinstance(values, dict) else {}
