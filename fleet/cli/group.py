"""The group of all commands. An error ends a command with one line on stderr and with the status of the error."""

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
BROKEN = 3  # the exit status of an error that has none of its own: those of the network


class FleetGroup(click.Group):
    """A group whose commands do not catch errors to print them: the group does."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; an error of this package becomes a line on stderr and an exit status."""
        try:
            return super().invoke(ctx)
        except (FleetError, NetemError) as error:
            ctx.exit(report(error))
        except OSError as error:  # of a place that no command words by itself, as with a name that is too long
            where = "" if error.filename is None else f"{error.filename}: "
            click.echo(f"fleet: {where}{error.strerror or error}", err=True)
            # One that names a file is about what was asked for; a disk that is full or fails names none.
            ctx.exit(BROKEN if error.filename is None else 2)
        except UnicodeEncodeError as error:  # of an argument with bytes that are no text
            click.echo(f"fleet: {error.object[:80]!r} is not UTF-8 text", err=True)
            ctx.exit(2)


def report(error: Exception) -> int:
    """Print an error on stderr, and return the exit status that belongs to it."""
    click.echo(f"fleet: {error}", err=True)
    return int(getattr(error, "status", BROKEN))


@contextmanager
def exit_status(status: int) -> Iterator[None]:
    """Set the exit status of every error of this package that is raised inside."""
    try:
        yield
    except (FleetError, NetemError) as error:
        error.status = status  # type: ignore[union-attr]
        raise
