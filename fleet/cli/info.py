"""The command `fleet info`."""

from __future__ import annotations

from fleet.cli.declare import command
from fleet.cli.documents.output import print_result
from fleet.cli.log_argument import Log
from fleet.cli.types import NoProgress
from fleet.terminal.progress import showing


@command(document="fleet.logs.info.Info")
def info(log: Log, *, quiet: NoProgress = False) -> None:
    """Summarise LOG (an MCAP file, a run directory, or a bag of ROS 2), also if it was cut short.

    \b
    Examples:
      fleet info
      fleet info runs/latest/run.mcap --json
    """
    from fleet.logs.info import info_text, read_info

    with showing(f"reading {log}") as on_progress:
        found = read_info(log, on_progress)
    print_result(found, info_text(found))
