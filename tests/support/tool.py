"""Commands of the command line, in this process."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from fleet.cli.main import cli


def invoke(*arguments: object) -> Result:
    """A command, as on a terminal of 100 columns (click leaves two of them free); nothing but SystemExit leaves it."""
    result = CliRunner().invoke(cli, [str(each) for each in arguments], prog_name="fleet", terminal_width=98)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def tool(out: Path, *arguments: str) -> Result:
    """A command for the newest run below a directory, as from another terminal, but without starting Python."""
    return invoke(*arguments, "--run", out / "latest")
