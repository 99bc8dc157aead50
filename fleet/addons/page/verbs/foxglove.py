"""`fleet view --foxglove`: a live run or a log for Foxglove and Lichtblick."""

from __future__ import annotations

import ipaddress
from importlib.util import find_spec
from typing import TYPE_CHECKING

import click

from fleet.addons.page.source import LiveSource, LogSource
from fleet.cli.sessions import ending
from fleet.mcap.seekable_log import SeekableLog
from fleet.replay.live_journal import LiveJournal
from fleet.terminal.keyboard import Keyboard
from fleet.terminal.progress import showing
from fleet.terminal.status_line import StatusLine
from netem.wire.session import quiet_zenoh

if TYPE_CHECKING:
    from fleet.addons.page.foxglove_server import FoxgloveServer


def serve(
    source: LiveSource | LogSource, host: str, port: int | None, *, control: bool, rate: float, loop: bool
) -> None:
    """Serve viewers: of a live run until it is over, of a log until Ctrl-C.

    Args:
        port: None: the default port of viewers, or a free one.
        control: viewers may disturb a live run.
        rate: speed of a log, as a multiple of real time.
    """
    if find_spec("foxglove") is None:
        raise click.UsageError(
            "--foxglove needs foxglove-sdk, which is not installed: pip install 'uuv-fleet[foxglove]'"
        )
    with StatusLine(quiet=False) as line:
        if isinstance(source, LogSource):
            _serve_log(source, host, port, line, rate=rate, loop=loop)
        else:
            _serve_live(source, host, port, line, control=control)


def _serve_live(source: LiveSource, host: str, port: int | None, line: StatusLine, *, control: bool) -> None:
    from fleet.addons.page.foxglove_live import LiveBridge  # needs foxglove-sdk

    quiet_zenoh()
    line.print(f"the live run in {source.directory}")
    with ending() as sessions:
        journal = LiveJournal.connect(source.observed, source.directory.name)
        sessions.append(journal)
        bridge = LiveBridge(source, journal, host, port, control=control)
        sessions.append(bridge.server)
        _say_where(bridge.server, line)
        what = "disturb the run and watch it" if control else "watch it; --control would let them disturb it, too"
        line.print(f"{_who(host)} can {what}")
        bridge.run(line)
        line.print(f"the run is over; its log: fleet view --foxglove {source.directory}")


def _serve_log(source: LogSource, host: str, port: int | None, line: StatusLine, *, rate: float, loop: bool) -> None:
    from fleet.addons.page.foxglove_log import LogBridge  # needs foxglove-sdk

    with showing(f"reading {source.path}") as on_progress:
        log = SeekableLog(source.path, on_progress)
    with ending() as sessions:
        if log.missing:
            line.print(f"warning: {source.path}: {log.missing}")
        bridge = LogBridge(log, host, port, rate=rate, loop=loop)
        sessions.append(bridge.server)
        line.print(f"the log {source.path}")
        _say_where(bridge.server, line)
        line.print(f"{_who(host)} can watch it, and control how it is played")
        with Keyboard() as keyboard:
            if keyboard.there:
                line.print("space: pause; right arrow: step; up, down: rate; ] and [: 5 s on or back; Ctrl-C: end")
            bridge.run(keyboard, line)


def _say_where(server: FoxgloveServer, line: StatusLine) -> None:
    line.print(f"in Foxglove or Lichtblick: Open connection, Foxglove WebSocket, {server.endpoint}")


def _who(host: str) -> str:
    """The people who can reach a port at an address, in words. The protocol knows no passwords."""
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = host == "localhost"
    here = "whoever is on this host, and a page in your browser,"
    return here if local else f"warning: whoever reaches {host}, and a page in your browser,"
