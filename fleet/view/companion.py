"""The page of a run that `fleet run --view` opens: a process of its own, which ends with the run's command.

Its stdin: one line of JSON, then nothing; when it ends, the page does.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, live_runs
from fleet.view.live_feed import LiveFeed
from fleet.view.server import Door, serve
from fleet.view.source import LiveSource, find_source

# With `-m` a file in the current directory could take the place of a module.
_MAIN = "import sys; sys.path.append(sys.argv[1]); from fleet.view.companion import main; main()"
POLL_S = 0.1
CLOSE_S = 5.0


class Companion:
    """The process with the page, as the run's command sees it."""

    def __init__(self, door: Door) -> None:
        """Start it: it shows the live run whose console is this process, as soon as there is one."""
        descriptor = door.listening.fileno()
        # A group of its own: Ctrl-C is the run's business. The token goes through the pipe, which nobody else sees.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _MAIN, str(Path(__file__).parents[2])],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[descriptor],
            process_group=0,
        )
        values = {
            "console": os.getpid(),
            "listening": descriptor,
            "host": door.host,
            "port": door.port,
            "token": door.token,
        }
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(values).encode() + b"\n")
        self._process.stdin.flush()
        door.listening.close()  # it is the companion's now

    def wait(self) -> None:
        """Until it ends by itself."""
        self._process.wait()

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main() -> None:
    """Show the run of a console until stdin ends."""
    values = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    listening = socket.socket(fileno=values["listening"])
    try:
        run = _run_of(values["console"])
        source = find_source(str(run.directory), run.directory)
        assert isinstance(source, LiveSource)  # it lives, and is published
        serve(LiveFeed(source), Door(values["host"], values["port"], listening, values["token"]), may_act=True)
    except FleetError as error:
        print(f"fleet view: {error}", file=sys.stderr)
        sys.exit(error.status)


def _run_of(console: int) -> LiveRun:
    """The live run with this console, once it can be asked."""
    while True:
        found = next((run for run in live_runs() if run.pid == console), None)
        if found is not None and (found.directory / "observe.json").exists():
            return found
        time.sleep(POLL_S)


def _end_with_stdin() -> None:
    sys.stdin.buffer.read()
    os.kill(os.getpid(), signal.SIGTERM)
