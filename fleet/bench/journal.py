"""How fast a journal is written, read and played, and how large it is: part of `fleet bench`."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console as Terminal

from fleet.bench.errors import BenchError
from fleet.logs.reader import LogReader
from fleet.logs.tape import Tape
from fleet.processes.ports import free_port
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot
from fleet.recorder.writer import LogWriter
from fleet.replay.capture import Limits, Recorder, TrafficWriter
from fleet.replay.playback import PlaybackOptions, Replay
from fleet.run.clock import Clock
from fleet.run.in_process import InProcess
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from fleet.terminal.keyboard import Keyboard
from fleet.terminal.status_line import StatusLine
from fleet.terminal.table import columns
from fleet.terminal.table import show as show_table
from netem.wire.messages import Command, Fate, Frame
from netem.wire.open_bus import OpenBus

PATIENCE_S = 60.0


class _Timed:
    """A log writer with a stopwatch."""

    def __init__(self, log: LogWriter) -> None:
        self._log = log
        self.s = 0.0

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        began = time.perf_counter()
        self._log.frame(frame, commands, errors)
        self.s += time.perf_counter() - began

    def packet(self, fate: Fate) -> None:
        began = time.perf_counter()
        self._log.packet(fate)
        self.s += time.perf_counter() - began

    def event(self, event: Event) -> None:
        self._log.event(event)

    def snapshot(self, snapshot: Snapshot) -> None:
        self._log.snapshot(snapshot)


def measure_recorder(scenario: Scenario, say: Callable[[str], None]) -> dict[str, float]:
    """Figures of the journal of one scenario; messages per wall second, sizes per simulated minute.

    `record` is what reaches a file over zenoh, player and recorder sharing this process; the others are one core's.

    Raises:
        BenchError: the recorder did not get everything.
    """
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-bench-") as folder:
        path, copy = Path(folder) / "run.mcap", Path(folder) / "copy.mcap"
        say(f"N = {scenario.vehicles}: journal, written and read")
        file = LogFile(path)
        timed = _Timed(LogWriter(file, scenario))
        clock = Clock.of(scenario)
        InProcess(scenario, Journal(scenario, timed)).serve(clock, lambda: None)
        file.close()
        began = time.perf_counter()
        count = sum(1 for _ in LogReader(path))
        read_s = time.perf_counter() - began
        began = time.perf_counter()
        tape = Tape(path)
        scan_s = time.perf_counter() - began
        say(f"N = {scenario.vehicles}: journal, played and recorded")
        play_s = _play(tape, PlaybackOptions(rate=0.0), None)
        record_s = _play(tape, PlaybackOptions(rate=0.0, wait=True), copy)
        minutes = scenario.duration_ns / 60e9
        return {
            "vehicles": scenario.vehicles,
            "messages": count,
            "written": count / timed.s,
            "read": count / read_s,
            "scanned": count / scan_s,
            "replayed": count / play_s,
            "record": count / record_s,
            "mb_per_minute": path.stat().st_size / 1e6 / minutes,
            "mb_per_vehicle_minute": path.stat().st_size / 1e6 / minutes / scenario.vehicles,
        }


def _play(tape: Tape, options: PlaybackOptions, copy: Path | None) -> float:
    """Wall seconds until everything is published, and in the file if there is one."""
    replay, line = Replay(tape, options), StatusLine(Terminal(stderr=True), quiet=True)
    bus = OpenBus.listen(f"tcp/127.0.0.1:{free_port(None)}")
    other = None
    try:
        replay.open(bus)
        if copy is None:
            began = time.perf_counter()
            replay.play(Keyboard(), line)
            return time.perf_counter() - began
        other = OpenBus.connect(bus.endpoint)
        recorder, writer = Recorder(other, ["fleet/**"]), TrafficWriter(copy, ["fleet/**"])
        while replay.unmatched():
            time.sleep(0.01)
        player = threading.Thread(target=replay.play, args=(Keyboard(), line))
        began = time.perf_counter()
        player.start()
        try:
            while writer.samples < replay.messages:
                recorder.record(writer, Limits(duration_ns=50_000_000), line)
                if time.perf_counter() - began > PATIENCE_S:
                    raise BenchError(f"{replay.messages - writer.samples} messages did not reach the recorder")
            return time.perf_counter() - began
        finally:
            player.join()
            recorder.finish(writer)
    finally:
        if other is not None:
            other.close()
        bus.close()


def show_journals(rows: list[dict[str, float]], terminal: Terminal) -> None:
    """Print the figures as a table."""
    names = {
        "vehicles": "N", "messages": "messages", "written": "written", "read": "read", "scanned": "opened\nto play",
        "replayed": "played,\nrate 0", "record": "played and\nrecorded", "mb_per_minute": "MB/min",
        "mb_per_vehicle_minute": "MB/min of\na vehicle",
    }  # fmt: skip
    ranks = {name: int(key.startswith("mb")) for key, name in names.items()}
    cells = [[f"{row[key]:.2f}" if key.startswith("mb") else f"{row[key]:.0f}" for key in names] for row in rows]
    show_table(columns(ranks, cells), "the journal, messages per second", terminal, "-o FILE")
