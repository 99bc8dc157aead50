"""The cost of writing a log: the calls of a real run once more, into our recorder and into the library's writer."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping
from typing import Any

from benchmarks.plain_log import PlainLog
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.mcap.reader import LogReader
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.metrics import VehicleError
from fleet.recorder.writer import LogWriter
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from netem.private_folder import PrivateFolder
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

    def repeat(self, log: LogWriter) -> None:
        """Tell a log writer the same."""
        methods = {name: getattr(log, name) for name in ("frame", "packet", "event")}
        for name, arguments in self.all:
            methods[name](*arguments)


def recorder_figures(scenario: Scenario) -> dict[str, tuple[float, str]]:
    """What a log costs, each with its unit: written by us and by the library, read, and its size.

    Writing counts CPU time from the first call to the end of the file, the best of several, in turn. Both encode by
    the same code; the library frames, indexes and hashes message by message.
    """
    with PrivateFolder("bench") as folder:
        path, calls = folder / "run.mcap", Calls.of(scenario)
        speeds: dict[type[LogFile | PlainLog], list[float]] = {PlainLog: [], LogFile: []}
        for _ in range(_REPEATS):
            for log, found in speeds.items():
                path.unlink(missing_ok=True)
                found.append(_speed(calls, scenario, log(path)))
        began = time.perf_counter()
        count = sum(1 for _ in LogReader(path))
        read_s = time.perf_counter() - began
        size = path.stat().st_size / 1e6 / (scenario.duration_ns / 60e9)
        return {
            "messages": (count, "messages"),
            "written": (max(speeds[LogFile]), "messages/s"),
            "written_mcap": (max(speeds[PlainLog]), "messages/s"),
            "read": (count / read_s, "messages/s"),
            "mb_per_minute": (size, "MB/min"),
            "mb_per_vehicle_minute": (size / scenario.vehicles, "MB/min of a vehicle"),
        }


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
