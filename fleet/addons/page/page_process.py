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
from typing import Any

from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.server import PageListener, serve
from fleet.addons.page.source import LiveSource, find_source
from fleet.errors import FleetError
from fleet.execution.directory import OBSERVE
from fleet.mcap.reader import log_path
from fleet.processes.side_process import begin, end, pipe

CLOSE_S = 5.0


class PageProcess:
    """The process with the page, as the run's command sees it."""

    def __init__(self, listener: PageListener) -> None:
        """Start it: it shows the run that it is told of."""
        descriptor = listener.listening.fileno()
        streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "pass_fds": [descriptor]}
        self._process = begin("fleet.addons.page.page_process", **streams)
        # The token goes through the pipe, which nobody else sees.
        self._say({"listening": descriptor, "host": listener.host, "port": listener.port, "token": listener.token})
        listener.listening.close()  # it is the page's now

    def on_run_published(self, directory: Path) -> None:
        """Say that the journal of the run can be read: the page is its first subscriber."""
        self._say(str(directory))

    # It is told of the run again when that is over: if the run was too short to be seen, its log is shown.
    on_run_ended = on_run_published

    def _say(self, told: str | dict[str, Any]) -> None:
        stdin = pipe(self._process.stdin)
        with suppress(OSError):  # it has ended
            stdin.write(json.dumps(told).encode() + b"\n")
            stdin.flush()

    def wait(self) -> None:
        self._process.wait()

    def close(self) -> None:
        pipe(self._process.stdin).close()
        end(self._process, CLOSE_S)


def main() -> None:
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
