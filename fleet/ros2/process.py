"""The bridge of a run that `fleet run --ros2` starts: `fleet ros2` in a process of its own, which ends with the run."""

from __future__ import annotations

import subprocess
from pathlib import Path

from fleet.processes.beside import begin, end, line_of, pipe
from fleet.terminal.table import say

READY_S = 30.0
CLOSE_S = 8.0  # after the run, for what is on its way


class BridgeProcess:
    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, directory: Path) -> None:
        """Start it, and wait until nodes can see the run. If they cannot, the run goes on without it."""
        # It ends with the run's publisher.
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
        self._process = begin("fleet.__main__", "ros2", str(directory), **streams)
        if not line_of(self._process, READY_S):
            self.close(0.0)
            say("warning: the run goes on without ROS 2, which fleet ros2 can join later", err=True)

    def close(self, limit_s: float = CLOSE_S) -> None:
        """End it, once it has published what there was."""
        process, self._process = self._process, None
        if process is not None:
            end(process, limit_s)
            pipe(process.stdout).close()
