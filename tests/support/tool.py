"""Commands of the command line, in this process."""

from __future__ import annotations

import subprocess
from pathlib import Path

from click.testing import CliRunner

from fleet.cli.main import cli


def tool(out: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command for the newest run below a directory, as from another terminal, but without starting Python."""
    result = CliRunner().invoke(cli, [*arguments, "--run", str(out / "latest")])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return subprocess.CompletedProcess(arguments, result.exit_code, result.stdout, result.stderr)
