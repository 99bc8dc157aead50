"""What starting costs: CPU time of short commands, to be compared with what Python alone takes to start and end."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

from fleet.errors import FleetError
from netem.private_folder import PrivateFolder

PYTHON = "python -c pass"
# Without the current directory on the path: a user's `signal.py` there is not ours.
_FLEET = [sys.executable, "-P", "-m", "fleet"]
_RUN = ["run", "paper", "--in-process", "--quiet", "--duration", "1 s", "--set", "checks={tumbled: waived}"]
COMMANDS = {
    PYTHON: [sys.executable, "-P", "-c", "pass"],
    "fleet --help": [*_FLEET, "--help"],
    "fleet --version": [*_FLEET, "--version"],
    "fleet list": [*_FLEET, "list"],
    "fleet check paper": [*_FLEET, "check", "paper"],
    "fleet run, 1 s simulated in one process": [*_FLEET, *_RUN],
}


def cpu_times(repeats: int) -> dict[str, float]:
    """CPU time of user and system [s] of each command.

    The commands take turns and the least time of each counts, because other work on the machine only ever adds. Byte
    code is there, as after an install, also where PYTHONDONTWRITEBYTECODE is set: in a folder of our own.

    Raises:
        FleetError: a command failed.
    """
    least = dict.fromkeys(COMMANDS, float("inf"))
    with PrivateFolder("bench") as folder:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = f"{folder}/byte-code"
        for repeat in range(repeats + 1):
            for name, command in COMMANDS.items():
                spent = _cpu_s(name, command, folder, environment)
                if repeat:  # the first one writes the byte code
                    least[name] = min(least[name], spent)
    return least


def _cpu_s(name: str, command: list[str], folder: Path, environment: dict[str, str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode:
        raise FleetError(f"{name} exited with status {ended.returncode}: {ended.stderr.strip()[-200:]}", status=3)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
