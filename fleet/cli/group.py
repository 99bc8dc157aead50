"""The group of all commands: every error of ours ends a command with one line on stderr and the error's own status."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from fleet.errors import FleetError
from netem.errors import NetemError

EPILOG = (
    "Exit status: 0 pass, 1 a check failed, 2 usage or bad scenario, 3 the run broke, 129 terminal closed, 130 Ctrl-C."
)
BROKEN = 3  # the status of an error that has none of its own: the network's


class FleetGroup(click.Group):
    """A group of commands, none of which needs to catch an error only to print it."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except (FleetError, NetemError) as error:
            ctx.exit(report(error))


def report(error: Exception) -> int:
    """Print an error as one line on stderr, and return the status with which the command ends."""
    click.echo(f"fleet: {error}", err=True)
    return int(getattr(error, "status", BROKEN))


@contextmanager
def exit_status(status: int) -> Iterator[None]:
    """Give every error of ours that is raised inside the exit status that it has for this command."""
    try:
        yield
    except (FleetError, NetemError) as error:
        error.status = status  # type: ignore[union-attr]
        raise
