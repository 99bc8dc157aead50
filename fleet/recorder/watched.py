"""A run that is recorded and watched: what the journal writes is also shown to somebody who measures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from fleet.recorder.journal import JournalSink
from fleet.recorder.metrics import VehicleError
from netem.wire.messages import Command, Frame


class Watcher(Protocol):
    """Sees every frame, with its decoded commands and errors by vehicle."""

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None: ...


class WatchedLog:
    """A sink of the journal that passes everything on."""

    def __init__(self, log: JournalSink, watcher: Watcher) -> None:
        self._log, self._watcher = log, watcher
        self.packet, self.event, self.snapshot = log.packet, log.event, log.snapshot

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        """Pass a frame on, then show it."""
        self._log.frame(frame, commands, errors)
        self._watcher.frame(frame, commands, errors)
