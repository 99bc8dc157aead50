"""The cost of writing a log: the calls of a real run once more, into our recorder and into the library's writer."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fleet.bench.plain_log import PlainLog
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot
from fleet.recorder.writer import LogWriter
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from netem.wire.messages import Command, Fate, Frame

_REPEATS = 3


class Calls:
    """A sink of the journal that keeps its calls, to repeat them."""

    def __init__(self) -> None:
        self.all: list[tuple[str, tuple[Any, ...]]] = []  # name of the method, and its arguments

    @classmethod
    def of(cls, scenario: Scenario) -> Calls:
        """Those of a run in this process."""
        calls = cls()
        InProcess(scenario, Journal(scenario, calls)).serve(GrantPolicy.of(scenario), lambda: None)
        return calls

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        self.all.append(("frame", (frame, commands, errors)))

    def packet(self, fate: Fate) -> None:
        self.all.append(("packet", (fate,)))

    def event(self, event: Event) -> None:
        self.all.append(("event", (event,)))

    def snapshot(self, snapshot: Snapshot) -> None:
        self.all.append(("snapshot", (snapshot,)))

    def repeat(self, log: LogWriter) -> None:
        """Tell a log writer the same."""
        methods = {name: getattr(log, name) for name in ("frame", "packet", "event", "snapshot")}
        for name, arguments in self.all:
            methods[name](*arguments)


def recorder_figures(scenario: Scenario, path: Path) -> dict[str, float]:
    """Messages per second of CPU time: ours, the library's, and how many times faster ours is.

    From the first call to the end of the file, the best of several, in turn. Both encode by the same code; the library
    frames, indexes and hashes message by message.

    Args:
        path: of a log, which is written.
    """
    calls = Calls.of(scenario)
    speeds: dict[type[LogFile | PlainLog], list[float]] = {PlainLog: [], LogFile: []}
    for _ in range(_REPEATS):
        for log, found in speeds.items():
            path.unlink(missing_ok=True)
            found.append(_speed(calls, scenario, log(path)))
    ours, plain = max(speeds[LogFile]), max(speeds[PlainLog])
    return {"written": ours, "written_mcap": plain, "times_mcap": ours / plain}


def _speed(calls: Calls, scenario: Scenario, log: LogFile | PlainLog) -> float:
    writer = LogWriter(log, scenario)
    gc.collect()
    gc.freeze()  # a run does not hold all of its frames, so it does not look through them for garbage
    try:
        began = time.process_time()
        calls.repeat(writer)
        log.close()
        return log.messages / (time.process_time() - began)
    finally:
        gc.unfreeze()
