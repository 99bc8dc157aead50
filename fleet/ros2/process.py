"""The bridge of a run that `fleet run --ros2` starts: `fleet ros2` in a process of its own, which ends with the run."""

from __future__ import annotations

import select
import subprocess
import sys
from pathlib import Path

from fleet.terminal.table import say

# With `-m` a file in the current directory could take the place of a module.
_MAIN = "import sys; sys.path.append(sys.argv.pop(1)); from fleet.__main__ import main; main()"
READY_S = 30.0
CLOSE_S = 8.0  # after the run, for what is on its way


class BridgeProcess:
    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, directory: Path) -> None:
        """Start it, and wait until nodes can see the run. If they cannot, the run goes on without it."""
        command = [sys.executable, "-P", "-c", _MAIN, str(Path(__file__).parents[2]), "ros2", str(directory)]
        # A group of its own: Ctrl-C is the run's business. It ends with the run's publisher.
        self._process = process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, process_group=0
        )
        assert process.stdout is not None
        if not select.select([process.stdout], [], [], READY_S)[0] or not process.stdout.readline():
            self.close(0.0)
            say("warning: the run goes on without ROS 2, which fleet ros2 can join later", err=True)

    def close(self, limit_s: float = CLOSE_S) -> None:
        """End it, once it has published what there was."""
        process, self._process = self._process, None
        if process is None:
            return
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()
