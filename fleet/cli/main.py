"""The command line: the group of all commands.

Data go to stdout, everything else to stderr.
"""

from __future__ import annotations

import click

from fleet.cli.group import EPILOG, FleetGroup
from fleet.cores import cores_and_reason

_CORES = cores_and_reason().replace("%", "%%")


@click.group(
    cls=FleetGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EPILOG
)
@click.version_option(package_name="uuv-fleet", message=f"%(prog)s, version %(version)s, cores: {_CORES}")
def cli() -> None:
    """Emulate a fleet of underwater vehicles on a real, impaired pub/sub network.

    \b
    Examples:
      fleet list                           the scenarios that ship with the package
      fleet run paper                      run one: processes over zenoh, an MCAP log, a verdict
      fleet run my.yaml --seed 7 --speed 1 your own file, another seed, in real time
      fleet info                           summarise the log of the newest run
    """
