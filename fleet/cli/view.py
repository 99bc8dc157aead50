"""The command `fleet view`."""

from __future__ import annotations

import click

from fleet.cli import completion
from fleet.cli.log_argument import RUNS

EPILOG = "Exit status: 0 done, 2 usage or a bad file, 3 no connection or no port, 129 terminal closed, 130 Ctrl-C."


@click.command(epilog=EPILOG)
@click.argument(
    "what", metavar="[RUN|LOG]", required=False, shell_complete=completion.published_runs,
    help="A live run that was started with --publish (its name, its scenario or its directory), an MCAP file or the "
    "directory of a run; by default the live run that began last, or else the newest run below runs.",
)  # fmt: skip
@click.option("--foxglove", is_flag=True, help="Serve Foxglove and Lichtblick; needs uuv-fleet[foxglove].")
@click.option("--host", metavar="ADDRESS", default="127.0.0.1", show_default=True, help="Listen there.")
@click.option(
    "--port",
    metavar="PORT",
    type=click.IntRange(0, 65535),
    help="By default a free one; with --foxglove 8765, which viewers propose, if that is free.",
)
@click.option(
    "--control/--read-only", default=None,
    help="Whether viewers may inject, heal and hold the clock. Foxglove's protocol knows no passwords: there it is "
    "--read-only by default.",
)  # fmt: skip
@click.option("--no-open", is_flag=True, help="Do not open a browser.")
@click.option("-r", "--rate", metavar="X", type=click.FloatRange(0.001, 1000.0),
              help="Of a log: times its own pace, at first.")  # fmt: skip
@click.option("-l", "--loop", is_flag=True, help="Of a log: begin again at the end.")
def view(
    what: str | None,
    foxglove: bool,
    host: str,
    port: int | None,
    control: bool | None,
    no_open: bool,
    rate: float | None,
    loop: bool,
) -> None:
    """Show a live run or a log in a viewer.

    \b
    Examples:
      fleet view --foxglove                   the live run, for Foxglove or Lichtblick
      fleet view --foxglove --control         the same, and a service call cuts a link
      fleet view --foxglove runs/latest       a log: play, pause, seek
    """
    from fleet.view.source import find_source

    if not foxglove:
        raise click.UsageError("say for which viewer: --foxglove")
    from fleet.cli.foxglove import serve

    serve(find_source(what, RUNS), host, port, control=control is True, rate=rate, loop=loop)


COMMANDS = (view,)
