"""The folders of sockets: their paths are short enough, and kill -9 leaves none for long."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import pytest
from repository import ROOT

from fleet.errors import RunBroken
from fleet.processes.run_folder import RunFolder
from netem.private_folder import PREFIX, PrivateFolder

START = """
import os, signal, sys
from fleet.processes.children import start_forkserver
start_forkserver()
if sys.argv[1:]:
    os.kill(os.getpid(), signal.SIGKILL)
"""


def started(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A process that starts a fork server."""
    environment = os.environ | {"TMPDIR": str(place), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", START, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("place", ["/tmp/" + "long" * 30, "/tmp/what?", "/tmp/a#b", "/tmp/a,b", "/tmp/ä b"])
def test_a_place_that_the_socket_cannot_have(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too long for a socket, or with characters that mean something in an endpoint: another one is taken, or named."""
    monkeypatch.setattr(tempfile, "gettempdir", lambda: place)
    with closing(RunFolder()) as folder:
        assert folder.path.parent == Path("/tmp")
    monkeypatch.setattr("fleet.processes.run_folder.SHORT", place)
    with pytest.raises(RunBroken, match="set TMPDIR"):
        RunFolder()


def test_a_fork_server_that_was_killed_with_its_console_leaves_nothing_for_long() -> None:
    with PrivateFolder("test", Path("/tmp")) as folder:
        place = folder / "t"
        place.mkdir()
        assert started(place, "killed").returncode == -signal.SIGKILL
        (found,) = place.iterdir()
        assert found.name.startswith(PREFIX)
        assert started(place).returncode == 0
        assert not list(place.iterdir())


def test_a_fork_server_starts_where_tmpdir_is_long(tmp_path: Path) -> None:
    """A socket's path has at most 107 bytes."""
    place = tmp_path / ("long" * 30)
    place.mkdir()
    done = started(place)
    assert (done.returncode, done.stderr) == (0, "")
    assert not list(place.iterdir())
