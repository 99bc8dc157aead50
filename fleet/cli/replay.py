"""The command `fleet replay`."""

from __future__ import annotations

import time
from typing import Annotated, Any

import click

from fleet.cli.declare import command
from fleet.cli.group import exit_status
from fleet.cli.log_argument import Log
from fleet.cli.sessions import ending
from fleet.cli.types import ENDPOINT
from fleet.option import Option
from fleet.replay.player import PlaybackOptions
from fleet.terminal.progress import showing
from fleet.terminal.status_line import StatusLine

EPILOG = "Exit status: 0 done, 2 usage or a bad file, 3 no connection or a full disk, 129 terminal closed, 130 Ctrl-C."


Connect = Annotated[str | None, ENDPOINT, Option("Join the router or peer at this address, e.g. tcp/10.0.0.5:7447.")]
Listen = Annotated[
    str | None,
    ENDPOINT,
    Option("Be a router at this address; by default a free loopback port, which is printed."),
]
NoSummary = Annotated[bool, Option("No progress and no summary.", flag="-q --quiet")]


@command(epilog=EPILOG)
def replay(
    log: Log, *, options: PlaybackOptions, connect: Connect = None, listen: Listen = None, quiet: NoSummary = False
) -> None:
    """Publish LOG (an MCAP file, a run directory, or a bag of ROS 2) on zenoh again, at its own pace.

    On a terminal: space pauses, right arrow plays one tick, up and down change the rate by 10 %, ] and [ (or shift
    with right and left arrow) seek 5 s.

    \b
    Examples:
      fleet replay --listen tcp/127.0.0.1:7447
      fleet replay --speed 0 --wait-for-subscribers --topics 'uuv/*/pose'
      fleet replay robot.mcap --loop --start '20 s' --end '30 s' --connect tcp/127.0.0.1:7447
    """
    from fleet.mcap.reader import log_path
    from fleet.mcap.seekable_log import SeekableLog
    from fleet.replay.playback import Replay
    from fleet.terminal.keyboard import Keyboard

    if options.step and not Keyboard.possible():
        raise click.UsageError("--step needs a terminal, because a key press continues it")
    with showing(f"reading {log}", quiet=quiet) as on_progress:
        seekable = SeekableLog(log_path(log), on_progress)
    played = Replay(seekable, options)
    with exit_status(3), ending() as sessions, StatusLine(quiet=quiet) as line:
        if seekable.missing:
            line.print(f"warning: {log}: {seekable.missing}")
        if played.no_keys:
            line.print(f"warning: topics that are left out, being {played.left_out}")
        bus = open_session(connect, listen, None)
        sessions.append(bus)
        began = time.monotonic()
        try:
            played.open(bus)
            keys = f"{played.keys.prefix}/log/**" if played.ours else "its own keys"
            line.print(f"playing {played.messages} messages on {keys} at {bus.endpoint}")
            with Keyboard() as keyboard:
                played.play(keyboard, line)
        finally:
            line.print(played.summary(time.monotonic() - began))


def open_session(connect: str | None, listen: str | None, credentials: Any) -> Any:
    from fleet.processes.ports import free_port
    from netem.wire.open_bus import OpenBus
    from netem.wire.session import quiet_zenoh

    if connect and listen:
        raise click.UsageError("give either --connect or --listen, not both")
    quiet_zenoh()
    with exit_status(3):
        if connect:
            return OpenBus.connect(connect, credentials)
        return OpenBus.listen(listen or f"tcp/127.0.0.1:{free_port(None)}")
