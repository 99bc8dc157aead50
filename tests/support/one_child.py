"""Several commands of `fleet` one after another in one Python process, which starts once for all of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from repository import ROOT

_CODE = """
import json, os, sys
from click.testing import CliRunner
from fleet.cli.main import cli
for folder, arguments in json.loads(sys.argv[1]):
    os.chdir(folder)
    done = CliRunner().invoke(cli, arguments, prog_name="fleet")
    failed = "" if isinstance(done.exception, (SystemExit, type(None))) else repr(done.exception)
    print(json.dumps([done.exit_code, done.stdout, done.stderr + failed]))
"""


class Done(NamedTuple):
    status: int
    stdout: str
    stderr: str


def in_one_child(
    commands: Sequence[tuple[Path, Sequence[str]]], path: Path = ROOT, before: str = "", isolated: bool = True
) -> list[Done]:
    """What becomes of each command, which begins in its folder.

    Args:
        commands: Folders with the arguments of `fleet`.
        path: What PYTHONPATH says.
        before: Code that runs before `fleet` is imported.
        isolated: Python finds nothing in the folder that is current at its start.
    """
    told = json.dumps([(str(folder), list(arguments)) for folder, arguments in commands])
    command = [sys.executable, *(["-P"] if isolated else []), "-c", before + _CODE, told]
    environment = os.environ | {"PYTHONPATH": f"{path}{os.pathsep}{ROOT}"}
    done = subprocess.run(
        command, cwd=commands[0][0], env=environment, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stderr
    return [Done(*json.loads(line)) for line in done.stdout.splitlines()]
