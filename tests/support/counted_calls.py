"""How many calls a tick takes, by module: a measure of speed that no other work on the machine changes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from fleet.execution import in_process
from fleet.execution.clock import GrantPolicy
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from netem.wire.codec import encode
from netem.wire.messages import Message

TICKS = 100  # a second: ten rounds, twenty optimisations, one snapshot, one flush
SHORT = 20
# The room of a module: by the first of these names that its own begins with.
ROOMS = {"agents": "agents", "world": "world", "netem.wire": "wire", "netem": "netem", "fleet.recorder": "recorder",
         "fleet.logs": "recorder", "mcap": "recorder"}  # fmt: skip


# In a process of its own: beside 217 threads that other tests had left, the profile function once never came back.
_APART = """
import json, sys
from pathlib import Path
from counted_calls import counted
print(json.dumps(counted(int(sys.argv[1]), Path(sys.argv[2]))))
"""


def counted_apart(vehicles: int, folder: Path) -> tuple[dict[str, float], dict[str, float]]:
    """As `counted`, whatever this process has done before."""
    command = [sys.executable, "-c", _APART, str(vehicles), str(folder)]
    found = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(command, env=found, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    calls, messages = json.loads(done.stdout)
    return calls, messages


def counted(vehicles: int, folder: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Of one tick of the paper's fleet, recorded, in one process: calls by module, and encoded messages by kind.

    Calls are those of Python's functions, in their module, and of C's, in the module that calls. What a run does once
    does not count: a longer run less a shorter one.
    """
    run(vehicles, SHORT, folder / "first.mcap")  # what is made on first use
    short, long = (run(vehicles, ticks, folder / f"{ticks}.mcap") for ticks in (SHORT, SHORT + TICKS))
    return _per_tick(long[0], short[0]), _per_tick(long[1], short[1])


def _per_tick(long: Counter[str], short: Counter[str]) -> dict[str, float]:
    return {name: (number - short[name]) / TICKS for name, number in long.items()}


def run(vehicles: int, ticks: int, log: Path) -> tuple[Counter[str], Counter[str]]:
    scenario = load_scenario("paper", [f"vehicles={vehicles}", f"duration={ticks * 10} ms", "checks={}"])
    file = LogFile(log)
    fleet = in_process.InProcess(scenario, Journal(scenario, LogWriter(file, scenario)))
    calls: Counter[str] = Counter()
    messages: Counter[str] = Counter()

    def counting(message: Message) -> bytes:
        messages[type(message).__name__] += 1
        return encode(message)

    def count(frame: FrameType, event: str, _: Any) -> None:
        if event in ("call", "c_call"):
            calls[frame.f_globals.get("__name__", "?")] += 1

    before = sys.getprofile()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_process, "encode", counting)
        sys.setprofile(count)
        try:
            fleet.serve(GrantPolicy.of(scenario), lambda: None)
        finally:
            sys.setprofile(before)
    file.close()
    del calls[__name__]
    return calls, messages


def by_room(calls: Mapping[str, float]) -> dict[str, float]:
    """Calls of the rooms; `loop` is what passes messages on, and everything else."""
    rooms: dict[str, float] = {}
    for module, number in calls.items():
        within = [name for name in ROOMS if f"{module}.".startswith(f"{name}.")]
        room = ROOMS[within[0]] if within else "loop"
        rooms[room] = rooms.get(room, 0.0) + number
    return rooms
