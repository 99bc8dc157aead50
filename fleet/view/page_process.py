"""The page of a run that `fleet run --view` opens: a process of its own, which ends with the run's command.

Its stdin has lines of JSON. The first says where to serve the page. The second has the directory of the run; it comes
when the journal can be read, before the run begins. The third comes with the same directory when the run is over. When
stdin ends, the page does.
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
from dataclasses import replace
from pathlib import Path
from queue import Queue

from fleet.errors import FleetError
from fleet.execution.directory import OBSERVE
from fleet.logs.reader import log_path
from fleet.view.live_feed import LiveFeed
from fleet.view.log_feed import LogFeed
from fleet.view.server import PageListener, serve
from fleet.view.source import LiveSource, find_source

# With `-m` a file in the current directory could take the place of a module.
_MAIN = "import sys; sys.path.append(sys.argv[1]); from fleet.view.page_process import main; main()"
CLOSE_S = 5.0


class PageProcess:
    """The process with the page, as the run's command sees it."""

    def __init__(self, listener: PageListener) -> None:
        """Start it: it shows the run that it is told of."""
        descriptor = listener.listening.fileno()
        # A group of its own: Ctrl-C is the run's business. The token goes through the pipe, which nobody else sees.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _MAIN, str(Path(__file__).parents[2])],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[descriptor],
            process_group=0,
        )
        values = {"listening": descriptor, "host": listener.host, "port": listener.port, "token": listener.token}
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(values).encode() + b"\n")
        self._process.stdin.flush()
        listener.listening.close()  # it is the page's now

    def published(self, directory: Path) -> None:
        """Say that the journal of the run can be read: the page is its first subscriber."""
        self._say(directory)

    def over(self, directory: Path) -> None:
        """Say that the run is over: if it was so short that it was never seen, its log is shown."""
        self._say(directory)

    def _say(self, directory: Path) -> None:
        assert self._process.stdin is not None
        with suppress(OSError):  # it has ended
            self._process.stdin.write(json.dumps(str(directory)).encode() + b"\n")
            self._process.stdin.flush()

    def wait(self) -> None:
        self._process.wait()

    def close(self) -> None:
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
    told: Queue[Path] = Queue()
    threading.Thread(target=_listen, args=(told,), daemon=True).start()
    listening = socket.socket(fileno=values["listening"])
    try:
        feed = _feed_of(told)
        serve(feed, PageListener(values["host"], values["port"], listening, values["token"]), may_act=True)
    except FleetError as error:
        print(f"fleet view: {error}", file=sys.stderr)
        sys.exit(error.status)


def _feed_of(told: Queue[Path]) -> LiveFeed | LogFeed:
    """The live run that is told of first; if it ended before it could be seen, its log. Raises FleetError: there is no
    log, or the run cannot be shown."""
    directory = told.get()
    try:
        source = find_source(str(directory), directory) if (directory / OBSERVE).exists() else None
        if isinstance(source, LiveSource):
            return LiveFeed(replace(source, awaited=True))
    except FleetError:
        if (directory / OBSERVE).exists():
            raise
    feed = LogFeed(log_path(told.get()))  # which comes when the run is over
    feed.seek(feed.first_failure_s())
    return feed


def _listen(told: Queue[Path]) -> None:
    while line := sys.stdin.buffer.readline():
        told.put(Path(json.loads(line)))
    os.kill(os.getpid(), signal.SIGTERM)
