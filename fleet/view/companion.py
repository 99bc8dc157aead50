"""The page of a run that `fleet run --view` opens: a process of its own, which ends with the run's command.

Its stdin: one line of JSON, and when the run is over a second one with its directory; when it ends, the page does.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue

from fleet.errors import FleetError
from fleet.execution.connection import live_runs
from fleet.execution.directory import OBSERVE
from fleet.logs.reader import log_path
from fleet.view.live_feed import LiveFeed
from fleet.view.log_feed import LogFeed
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

    def over(self, directory: Path) -> None:
        """Say that the run is over: if it was so short that it was never seen, its log is shown."""
        assert self._process.stdin is not None
        with suppress(OSError):  # it has ended
            self._process.stdin.write(json.dumps(str(directory)).encode() + b"\n")
            self._process.stdin.flush()

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
    over: Queue[Path] = Queue()
    threading.Thread(target=_listen, args=(over,), daemon=True).start()
    listening = socket.socket(fileno=values["listening"])
    try:
        feed = _feed_of(values["console"], over)
        serve(feed, Door(values["host"], values["port"], listening, values["token"]), may_act=True)
    except FleetError as error:
        print(f"fleet view: {error}", file=sys.stderr)
        sys.exit(error.status)


def _feed_of(console: int, over: Queue[Path]) -> LiveFeed | LogFeed:
    """The live run with this console, once it can be asked; if it ended before that, its log.

    Raises:
        FleetError: there is no log, or the run cannot be shown.
    """
    while True:
        with suppress(Empty):
            return LogFeed(log_path(over.get(timeout=POLL_S)))
        found = next((run for run in live_runs() if run.pid == console), None)
        if found is None or not (found.directory / OBSERVE).exists():
            continue
        try:
            source = find_source(str(found.directory), found.directory)
            if isinstance(source, LiveSource):
                return LiveFeed(source)
        except FleetError:
            if found.directory.exists() and (found.directory / OBSERVE).exists():
                raise
        # else it ended meanwhile, and its log comes


def _listen(over: Queue[Path]) -> None:
    if line := sys.stdin.buffer.readline():
        over.put(Path(json.loads(line)))
        sys.stdin.buffer.read()
    os.kill(os.getpid(), signal.SIGTERM)
