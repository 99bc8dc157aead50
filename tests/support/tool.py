"""Commands of the command line, in this process."""

from __future__ import annotations

import subprocess
from pathlib import Path

from click.testing import CliRunner, Result

from fleet.cli.main import cli


def command(*arguments: object) -> Result:
    """`fleet` with these arguments, in this process."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments], prog_name="fleet")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def tool(out: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command for the newest run below a directory, as from another terminal, but without starting Python."""
    result = command(*arguments, "--run", out / "latest")
    return subprocess.CompletedProcess(arguments, result.exit_code, result.stdout, result.stderr)
