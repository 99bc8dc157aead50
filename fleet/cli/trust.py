"""The option --trust of the commands that run laws."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any, TypeVar

import click

from world.plugins.trust import SHA256, Trust

F = TypeVar("F", bound=Callable[..., Any])
_EVERYTHING = "all"


class TrustingCommand(click.Command):
    """A command whose --trust needs no value, not even in front of an argument."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        alone = f"--trust={_EVERYTHING}"
        pairs = pairwise([*args, ""])
        args = [alone if arg == "--trust" and not after.startswith(SHA256) else arg for arg, after in pairs]
        return super().parse_args(ctx, args)


def _trust(context: click.Context, option: click.Parameter, values: tuple[str, ...]) -> Trust:
    listed = [value for value in values if value != _EVERYTHING]
    for value in listed:
        if not re.fullmatch(SHA256 + "[0-9a-fA-F]{64}", value):
            raise click.BadParameter(f"expected --trust alone, or --trust {SHA256} and 64 digits, got {value!r}")
    return Trust(
        _EVERYTHING in values,
        frozenset(value.removeprefix(SHA256).lower() for value in listed),
        lambda text: click.echo(f"fleet: {text}", err=True),
    )


def trust_option(command: F) -> F:
    """Add --trust, which says which laws may run although they are not installed."""
    return click.option(
        "--trust",
        metavar="[sha256:HEX]",
        multiple=True,
        callback=_trust,
        help="Also run laws that are not installed and not your own; with sha256:HEX only the file with this "
        "hash; repeatable.",
    )(command)
