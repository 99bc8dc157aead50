"""The command `fleet view`."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.page.verbs.shown import LogLoop, LogRate, Shown, find_shown
from fleet.cli.declare import command
from fleet.cli.types import Whole
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.addons.page.source import LiveSource, LogSource

EPILOG = "Exit status: 0 done, 2 usage or a bad file, 3 no connection or no port, 129 terminal closed, 130 Ctrl-C."


@command(epilog=EPILOG)
def view(
    what: Shown = None,
    *,
    foxglove: Annotated[bool, Option("Serve Foxglove and Lichtblick; needs uuv-fleet[foxglove].")] = False,
    host: Annotated[str, Option("Listen there.", "ADDRESS")] = "127.0.0.1",
    port: Annotated[int | None, Whole(0, 65535), Option(
        "By default a free one. With --foxglove it is 8765, if that is free: viewers propose it.", "PORT")] = None,
    control: Annotated[bool | None, Option(
        "Whether viewers may inject, heal and pause. Foxglove's protocol knows no passwords, so it is --read-only by "
        "default with --foxglove.", flag="--control/--read-only")] = None,
    no_open: Annotated[bool, Option("Do not open a browser.")] = False,
    rate: Annotated[LogRate, Option(
        "For a log: speed at first, in multiples of its own pace.", "X", "-r --rate")] = None,
    loop: LogLoop = False,
) -> None:  # fmt: skip
    """Show a live run or a log in a viewer.

    A page in the browser shows the fleet, its links and its faults. A click on a link or a vehicle
    disturbs it. You can play, pause and search a log. The address of the page contains a token; without it nobody
    gets in.

    \b
    Examples:
      fleet view                              the live run of this folder, or the newest log
      fleet view runs/latest                  a log: play, pause, seek, next fault
      fleet view paper --read-only            to watch only
      fleet view --foxglove                   the live run, for Foxglove or Lichtblick
      fleet view --foxglove --control         the same, and a service call cuts a link
      fleet view --foxglove runs/latest       a log: play, pause, seek
    """
    from fleet.addons.page.source import LiveSource

    source = find_shown(what, rate, control=control is True, loop=loop)
    if isinstance(source, LiveSource) and control:
        source.open_control()
    rate = 1.0 if rate is None else rate
    if foxglove:
        from fleet.addons.page.verbs.foxglove import serve

        serve(source, host, port, control=control is True, rate=rate, loop=loop)
        return
    show_page(source, host, port, may_act=control is not False, browser=not no_open, rate=rate, loop=loop)


def show_page(
    source: LiveSource | LogSource,
    host: str,
    port: int | None,
    *,
    may_act: bool,
    browser: bool,
    rate: float,
    loop: bool,
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        port: of the page; None: any free one.
        may_act: the page may disturb the run.
        rate: speed of a log, as a multiple of real time.
    """
    from fleet.addons.page.live_feed import LiveFeed
    from fleet.addons.page.log_feed import LogFeed
    from fleet.addons.page.server import Browser, is_loopback, open_listener, serve
    from fleet.addons.page.source import LiveSource
    from fleet.terminal.width import say

    listener = open_listener(host, port)
    if not is_loopback(host):
        may = "watch" if not may_act else "watch the run, and disturb it"
        say(f"warning: everybody who knows this address may {may}, and it travels unencrypted. Use a network that "
            f"you trust, or ssh -L", err=True)  # fmt: skip
    with closing(listener.listening):
        feed: LiveFeed | LogFeed
        if isinstance(source, LiveSource):
            feed = LiveFeed(source)
        else:
            feed = LogFeed(source.path, rate, loop=loop)
            feed.seek(feed.first_failure_s())
        what = "live run" if feed.live else "log"
        click.echo(f"{what} {feed.name}, until Ctrl-C:\n  {listener.address}")
        with closing(Browser(listener.address)) as opened:
            if browser:
                opened.open()
            serve(feed, listener, may_act=may_act)
    raise KeyboardInterrupt
