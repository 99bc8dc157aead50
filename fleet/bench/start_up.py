"""What starting costs: CPU time of short commands, also as multiples of what Python alone takes to start and end."""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from typing import Any

from rich.table import Table

from fleet.bench.errors import BenchError

PYTHON = "python -c pass"
# Without the current directory on the path: a user's `signal.py` there is not ours.
_FLEET = [sys.executable, "-P", "-m", "fleet"]
_RUN = ["run", "paper", "--in-process", "--quiet", "--duration", "1 s", "--set", "checks={tumbled: waived}"]
COMMANDS = {
    PYTHON: [sys.executable, "-P", "-c", "pass"],
    "fleet --version": [*_FLEET, "--version"],
    "fleet list": [*_FLEET, "list"],
    "fleet check paper": [*_FLEET, "check", "paper"],
    "fleet run, 1 s simulated in one process": [*_FLEET, *_RUN],
}


def measure_start_up(repeats: int) -> list[dict[str, Any]]:
    """Name, CPU time of user and system [s], and its ratio to Python's own, of each command.

    The commands take turns and the least time of each counts, because other work on the machine only ever adds.

    Raises:
        BenchError: a command failed.
    """
    least = dict.fromkeys(COMMANDS, float("inf"))
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-bench-") as folder:
        for _ in range(repeats):
            for name, command in COMMANDS.items():
                least[name] = min(least[name], _cpu_s(name, command, folder))
    return [{"command": name, "cpu_s": cpu_s, "ratio": cpu_s / least[PYTHON]} for name, cpu_s in least.items()]


def start_up_table(rows: list[dict[str, Any]]) -> Table:
    """The figures of `measure_start_up`."""
    table = Table(title="start-up, CPU time", title_justify="left", box=None, pad_edge=False)
    for heading in ("command", "s", "x Python alone"):
        table.add_column(heading, justify="left" if heading == "command" else "right")
    for row in rows:
        table.add_row(row["command"], f"{row['cpu_s']:.3f}", f"{row['ratio']:.1f}")
    return table


def _cpu_s(name: str, command: list[str], folder: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode:
        raise BenchError(f"{name} exited with status {ended.returncode}: {ended.stderr.strip()[-200:]}")
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
