"""One way out of the command line."""

from __future__ import annotations

import sys
from typing import Any

import click

from fleet.errors import FleetError

EPILOG = (
    "Exit status: 0 pass, 1 a check failed, 2 usage or bad scenario, 3 the run broke, 129 terminal closed, 130 Ctrl-C."
)


def fail(error: FleetError) -> Any:
    click.echo(f"fleet: {error}", err=True)
    sys.exit(error.status)
