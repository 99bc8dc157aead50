"""A process beside a run, such as its publisher: it runs a `main` of this package, and ends with the run."""

from __future__ import annotations

import select
import subprocess
import sys
from pathlib import Path
from typing import IO, Any

# With `-m` a file in the current directory could take the place of a module, a user's `signal.py` for instance.
_MAIN = "import sys; sys.path.append(sys.argv.pop(1)); from {} import main; main()"


def begin(module: str, *arguments: str, **settings: Any) -> subprocess.Popen[bytes]:
    """Start the `main` of a module in a group of its own: Ctrl-C is the run's business."""
    command = [sys.executable, "-P", "-c", _MAIN.format(module), str(Path(__file__).parents[2]), *arguments]
    return subprocess.Popen(command, process_group=0, **settings)


def end(process: subprocess.Popen[bytes], limit_s: float) -> None:
    """Wait for the end of a process for this time, and then kill it."""
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def line_of(process: subprocess.Popen[bytes], limit_s: float | None) -> bytes:
    """The next line of its standard output; empty: it has ended, or does not say one in time."""
    stdout = pipe(process.stdout)
    return stdout.readline() if select.select([stdout], [], [], limit_s)[0] else b""


def pipe(stream: IO[bytes] | None) -> IO[bytes]:
    """A standard stream of a process that was started with a pipe."""
    assert stream is not None
    return stream
