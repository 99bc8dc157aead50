"""Sessions, commands and files of tests that play and record."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import mkstemp
from typing import Any

import pytest
from in_process_runs import Alone, log_of
from repository import ROOT
from waiting import wait_for

from fleet.logs.reader import LogReader, LogReadError, Record
from fleet.logs.tape import Tape
from fleet.processes.limits import free_port
from netem.wire.open_bus import OpenBus, ZenohSample, place_of, sample_of

LIMIT_S = 60.0  # for a machine that does other things at the same time
SHORT = ["duration=2 s", "checks={}"]


def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port(None)}"


class Command:
    """`python -m fleet ...` in the background; nothing of it is left when the `with` block ends."""

    def __init__(self, *arguments: Any, most_kib: int | None = None, environment: dict[str, str] | None = None) -> None:
        """`most_kib`: the largest file that it may write [KiB]."""
        limit = [] if most_kib is None else ["bash", "-c", f'ulimit -f {most_kib}; exec "$@"', "bash"]
        descriptor, name = mkstemp(prefix="printed-")
        self._printed = Path(name)
        with os.fdopen(descriptor, "wb") as printed:
            self._process = subprocess.Popen(
                [*limit, sys.executable, "-m", "fleet", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.STDOUT,
                env=os.environ | (environment or {}),
            )
        self.pid = self._process.pid

    def __enter__(self) -> Command:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(60)
        self._printed.unlink()

    @property
    def printed(self) -> str:
        return self._printed.read_text("utf-8", "replace")

    def until(self, text: str) -> Command:
        """Wait until it has printed that."""
        wait_for(lambda: text in self.printed or self._process.poll() is not None, LIMIT_S, f"{text!r}")
        assert text in self.printed, self.printed
        return self

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def status(self) -> int:
        return self._process.wait(LIMIT_S)


class Ear:
    """Everything that is heard on a key expression, in order."""

    def __init__(self, bus: OpenBus, key: str) -> None:
        self.samples: list[ZenohSample] = []
        self.places: list[int | None] = []
        bus.subscribe(key, self._hear)

    def _hear(self, received: Any) -> None:
        self.samples.append(sample_of(received))
        self.places.append(place_of(received))

    def until(self, count: int) -> list[ZenohSample]:
        wait_for(lambda: len(self.samples) >= count, LIMIT_S, f"{count} samples, {len(self.samples)} came")
        return self.samples


@contextlib.contextmanager
def session(bus: OpenBus) -> Iterator[OpenBus]:
    try:
        yield bus
    finally:
        bus.close()


@pytest.fixture(scope="module")
def log(alone: Alone) -> Path:
    """Two seconds of the paper's fleet."""
    return log_of(alone("paper", *SHORT))


@pytest.fixture(scope="module")
def records(log: Path) -> list[Record]:
    return list(LogReader(log))


def times(tape: Tape) -> list[int]:
    """When each message is due."""
    return [tape.due(n) for n in range(len(tape))]


def schemas_of(log: Path) -> dict[str, str]:
    """Topic -> name of its schema."""
    tape = Tape(log)
    return {channel.topic: tape.schemas[channel.schema_id].name for channel in tape.channels.values()}


def len_of(path: Path) -> int:
    try:
        return len(Tape(path))
    except LogReadError:
        return 0


PAGE = (ROOT / "docs" / "guide" / "replay.md").read_text("utf-8")
