"""What a log costs: recording, reading, and bytes, of a run whose every tick is logged."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fleet.clock import Clock
from fleet.inprocess import InProcess
from fleet.journal import Journal, frame_every
from fleet.log import LogWriter
from fleet.reader import LogReader
from fleet.scenario import load_scenario


class _Timed:
    """A log writer with the time spent in it."""

    def __init__(self, log: LogWriter) -> None:
        self.s = 0.0
        self.frame = self._timed(log.frame)
        self.packet = self._timed(log.packet)
        self.event = self._timed(log.event)
        self.snapshot = self._timed(log.snapshot)
        self.close = self._timed(log.close)

    def _timed(self, call: Callable[..., None]) -> Callable[..., None]:
        def timed(*arguments: Any) -> None:
            began = time.perf_counter()
            call(*arguments)
            self.s += time.perf_counter() - began

        return timed


def log_figures(sizes: Sequence[int], *, quick: bool) -> list[dict[str, float]]:
    """For each fleet size: messages/s of recorder and reader, and MB [1e6 bytes] per simulated minute."""
    rows = []
    for n in sizes:
        seconds = 1 if quick else max(4, min(60, 400 // n))
        scenario = load_scenario("paper", [f"vehicles={n}", f"duration={seconds} s", "checks={}"])
        with tempfile.TemporaryDirectory(prefix="uuv-fleet-bench-") as folder:
            path = Path(folder) / "run.mcap"
            log = LogWriter(path, scenario)
            timed = _Timed(log)
            clock = Clock(scenario.ticks, scenario.tick_ns, scenario.round_ticks, frame_every(scenario))
            InProcess(scenario, Journal(scenario, timed)).serve(clock, lambda: None)
            timed.close()
            began = time.perf_counter()
            read = sum(1 for _ in LogReader(path))
            read_s = time.perf_counter() - began
            megabytes = path.stat().st_size / 1e6 * 60 / seconds
        rows.append(
            {
                "vehicles": n,
                "recorder, messages/s": log.messages / timed.s,
                "reader, messages/s": read / read_s,
                "MB/min": megabytes,
                "MB per vehicle-minute": megabytes / n,
            }
        )
    return rows
