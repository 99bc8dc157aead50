"""Sessions, commands and files of tests that play and record."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest
from in_process_runs import Alone, log_of
from live import Command as Command
from repository import ROOT
from waiting import wait_for

from fleet.mcap.reader import LogReader, LogReadError, Record
from fleet.mcap.seekable_log import SeekableLog
from fleet.processes.ports import free_port
from netem.wire.open_bus import OpenBus, ZenohSample, place_of, sample_of

LIMIT_S = 60.0  # for a machine that does other things at the same time
SHORT = ["duration=2 s", "checks={}"]


def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port(None)}"


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


session = contextlib.closing


@pytest.fixture(scope="module")
def log(alone: Alone) -> Path:
    """Two seconds of the paper's fleet."""
    return log_of(alone("paper", *SHORT))


@pytest.fixture(scope="module")
def records(log: Path) -> list[Record]:
    return list(LogReader(log))


def times(tape: SeekableLog) -> list[int]:
    """When each message is due."""
    return [tape.due(n) for n in range(len(tape))]


def schemas_of(log: Path) -> dict[str, str]:
    """Topic -> name of its schema."""
    tape = SeekableLog(log)
    return {channel.topic: tape.schemas[channel.schema_id].name for channel in tape.channels.values()}


def len_of(path: Path) -> int:
    try:
        return len(SeekableLog(path))
    except LogReadError:
        return 0


PAGE = (ROOT / "docs" / "guide" / "replay.md").read_text("utf-8")
