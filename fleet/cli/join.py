"""The command `fleet agent`, which joins a run from outside."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from fleet.cli.group import report
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.processes.interrupts import ending_status

if TYPE_CHECKING:
    from agents.plugins.trust import Trust

_AGENT = (
    "Exit status: 0 the run is over; 2 it cannot join; 3 it had joined and its life ended before the run: a fault "
    "killed it, its link ended, its law failed; 129 terminal closed, 130 Ctrl-C."
)


@click.command(cls=TrustingCommand, epilog=_AGENT)
@click.option(
    "--join",
    "path",
    metavar="FILE",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="The join-<i>.json that fleet run wrote for an external vehicle.",
)
@trust_option
@click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
def agent(path: Path, trust: Trust, quiet: bool) -> None:
    """Run the agent of an external vehicle here, in this terminal, until the run is over.

    It is the agent that fleet run would have started: the scenario says which laws it runs, and the log is the same.

    \b
    Examples:
      fleet run paper --set "per_vehicle={3: {external: true}}"     in one terminal; in another:
      fleet agent --join runs/latest/join-3.json
    """
    import setproctitle

    from agents.join import serve
    from agents.join_file import JoinError, JoinFile
    from netem.wire.messages import RUN_OVER
    from netem.wire.session import quiet_zenoh

    def tell(text: str) -> None:
        if not quiet:
            click.echo(text, err=True)

    joined = False

    def begun(text: str) -> None:
        nonlocal joined
        joined = True
        tell(f"{text}; Ctrl-C leaves it")

    try:
        joining = JoinFile.read(path)
        setproctitle.setproctitle(f"fleet agent {joining.vehicle} [{joining.scenario}]")
        quiet_zenoh()
        end = serve(joining, begun, trust)
    except JoinError as error:
        report(error)
        _leave(3 if joined else 2)
    except KeyboardInterrupt as error:
        tell("left the run")
        _leave(ending_status(error))
    except SystemExit:
        _leave(3)  # the law failed, and what it raised has been printed
    except Exception as error:
        click.echo(f"fleet: the law failed: {type(error).__name__}: {error}", err=True)
        _leave(3)
    tell(f"agent {joining.vehicle}: {end.reason}")
    _leave(0 if end.reason == RUN_OVER else 3)


def _leave(status: int) -> NoReturn:
    # The interpreter's normal exit would wait for the thread that waits for a nav.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


COMMANDS = (agent,)
