"""A recorder alone, fed canned ticks and killed with SIGKILL at random moments: `bare_recorder.py DIR KILLS SEED`.

Prints one line of JSON for each: the log, and the last tick that the recorder had taken when it died. Forked from one
process that has everything imported and computed, so that fifty take a few seconds.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import sys
import time
from pathlib import Path

from repository import ROOT

from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario

sys.path.append(str(ROOT))
from benchmarks.recorder import Calls

OVERRIDES = ["vehicles=3", "duration=12 s", "checks={}", "network.links={'*': 'delay 200ms 50ms loss 30%'}"]


def record(path: Path, scenario: Scenario, calls: Calls, taken: mmap.mmap) -> None:
    """Write it all; `taken` says the last tick that is."""
    file = LogFile(path)
    log = LogWriter(file, scenario)
    for kind, arguments in calls.all:
        getattr(log, kind)(*arguments)
        if kind == "frame":
            taken[:8] = int(arguments[0].tick).to_bytes(8, "little")
    file.close()


def main(folder: Path, kills: int, seed: int) -> None:
    scenario = load_scenario("paper", OVERRIDES)
    calls = Calls.of(scenario)
    draw = random.Random(seed)
    taken = mmap.mmap(-1, 8)
    began = time.perf_counter()
    record(folder / "whole.mcap", scenario, calls, taken)
    whole_s = time.perf_counter() - began
    for number in range(kills):
        path = folder / f"{number}.mcap"
        taken[:8] = bytes(8)
        child = os.fork()
        if child == 0:
            record(path, scenario, calls, taken)
            os._exit(0)
        time.sleep(draw.uniform(0.0, whole_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        tick = int.from_bytes(taken[:8], "little")
        print(json.dumps({"log": str(path), "taken_s": tick * scenario.tick_ns / 1e9}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
