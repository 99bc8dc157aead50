"""Commands of the command line, in this process."""

from __future__ import annotations

from pathlib import Path

import click
from click.testing import CliRunner, Result

from fleet.cli.main import cli


def invoke(*arguments: object) -> Result:
    """A command, as on a terminal of 100 columns (click leaves two of them free); nothing but SystemExit leaves it."""
    result = CliRunner().invoke(cli, [str(each) for each in arguments], prog_name="fleet", terminal_width=98)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def commands(group: click.Group = cli) -> dict[str, click.Command]:
    """Every command by its name, those of groups with the group's name before them."""
    found: dict[str, click.Command] = {}
    context = click.Context(group)
    for name in sorted(group.list_commands(context)):
        found[name] = command = group.get_command(context, name)
        if isinstance(command, click.Group):
            found |= {f"{name} {inner}": one for inner, one in commands(command).items()}
    return found


def tool(out: Path, *arguments: str) -> Result:
    """A command for the newest run below a directory, as from another terminal, but without starting Python."""
    return invoke(*arguments, "--run", out / "latest")
