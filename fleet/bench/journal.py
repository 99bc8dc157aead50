"""How fast a journal is written, read and played, and how large it is: part of `fleet bench`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console as Terminal

from fleet.bench.recorder import recorder_figures
from fleet.errors import FleetError
from fleet.logs.reader import LogReader
from fleet.logs.tape import Tape
from fleet.processes.limits import free_port
from fleet.replay.capture import Limits, Recorder, TrafficWriter
from fleet.replay.playback import PlaybackOptions, Replay
from fleet.scenario.scenario import Scenario
from fleet.terminal.keyboard import Keyboard
from fleet.terminal.status_line import StatusLine
from fleet.terminal.table import columns
from fleet.terminal.table import show as show_table
from netem.private_folder import PrivateFolder
from netem.wire.open_bus import OpenBus

PATIENCE_S = 60.0


def measure_recorder(scenario: Scenario, say: Callable[[str], None]) -> dict[str, float]:
    """Figures of the journal of one scenario; messages per second, sizes per simulated minute.

    Figures of writing count CPU time, the rest wall time. `record` counts the messages that reach a file over zenoh,
    with player and recorder in this process. The others are for one core. `record` is what reaches a file over zenoh,
    player and recorder sharing this process; the others are one core's.

    Raises:
        FleetError: the recorder did not get everything.
    """
    with PrivateFolder("bench") as folder:
        path, copy = folder / "run.mcap", folder / "copy.mcap"
        say(f"N = {scenario.vehicles}: journal, written and read")
        written = recorder_figures(scenario, path)
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
            **written,
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
                    raise FleetError(
                        f"{replay.messages - writer.samples} messages did not reach the recorder", status=3
                    )
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
        "vehicles": "N", "messages": "messages", "written": "written", "times_mcap": "times\nmcap's", "read": "read",
        "scanned": "opened\nto play", "replayed": "played,\nrate 0", "record": "played and\nrecorded",
        "mb_per_minute": "MB/min", "mb_per_vehicle_minute": "MB/min of\na vehicle",
    }  # fmt: skip
    digits = {"times_mcap": 1, "mb_per_minute": 2, "mb_per_vehicle_minute": 2}
    ranks = {name: int(key.startswith("mb")) for key, name in names.items()}
    cells = [[f"{row[key]:.{digits.get(key, 0)}f}" for key in names] for row in rows]
    show_table(columns(ranks, cells), "the journal, messages per second", terminal, "-o FILE")
