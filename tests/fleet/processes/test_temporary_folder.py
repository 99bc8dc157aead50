"""The folder of a process: what a killed one leaves is removed by the next one, and nothing else is."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from repository import ROOT

from fleet.processes.temporary_folder import PREFIX, remove_deserted

OWNER = """
import os, sys, tempfile
from fleet.processes.temporary_folder import temporary_folder
folder = temporary_folder()
assert temporary_folder() == folder and oct(folder.stat().st_mode)[-3:] == "700"
(folder / "inner").mkdir()
(folder / "inner" / "file").write_text("x")
print(folder, flush=True)
if sys.stdin.readline() == "die\\n":
    os.kill(os.getpid(), 9)
"""


class Owner:
    """A process that has a folder."""

    def __init__(self, place: Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(place)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self.process.stdout is not None
        self.folder = Path(self.process.stdout.readline().strip())

    def end(self, how: str) -> None:
        """Tell it to end or to die, and wait for that."""
        self.process.communicate(how)


def test_what_a_killed_process_leaves_goes_with_the_next_one_and_that_of_a_living_one_stays(tmp_path: Path) -> None:
    place = tmp_path if len(str(tmp_path)) <= 60 else Path("/tmp")
    killed, living = Owner(place), Owner(place)
    killed.end("die\n")
    assert (killed.folder / "inner" / "file").exists()
    ended = Owner(place)
    assert not killed.folder.exists()
    assert (living.folder / "inner" / "file").exists()
    ended.end("end\n")
    assert not ended.folder.exists()
    living.end("end\n")
    assert not living.folder.exists()


def test_links_and_folders_that_are_not_ours_alone_stay(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir(mode=0o700)
    (precious / "owner").touch()
    (tmp_path / f"{PREFIX}link").symlink_to(precious)
    inner = tmp_path / f"{PREFIX}inner"
    inner.mkdir(mode=0o700)
    (inner / "owner").symlink_to(precious / "owner")
    open_to_all = tmp_path / f"{PREFIX}open"
    open_to_all.mkdir()
    open_to_all.chmod(0o755)
    (open_to_all / "owner").touch()
    beginning = tmp_path / f"{PREFIX}beginning"  # its owner has not locked it yet
    beginning.mkdir(mode=0o700)
    (tmp_path / f"{PREFIX}file").touch()
    deserted = tmp_path / f"{PREFIX}deserted"
    deserted.mkdir(mode=0o700)
    (deserted / "owner").touch()
    (deserted / "to").symlink_to(precious)
    remove_deserted(str(tmp_path))
    assert not deserted.exists()
    assert {path.name for path in tmp_path.iterdir()} == {
        "precious", *(PREFIX + name for name in ("link", "inner", "open", "beginning", "file"))
    }  # fmt: skip
    assert (precious / "owner").exists()


CONSOLE = """
import os, sys
from fleet.processes.children import start_forkserver
start_forkserver()
if sys.argv[1] == "die":
    os.kill(os.getpid(), 9)
"""


def test_a_console_that_is_killed_leaves_what_the_next_one_removes() -> None:
    with tempfile.TemporaryDirectory(prefix="t", dir="/tmp") as place:  # short: sockets go there
        environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": place}
        for how, left in (("die", 1), ("end", 0)):
            subprocess.run([sys.executable, "-c", CONSOLE, how], env=environment, check=False, timeout=100)
            names = os.listdir(place)
            assert len(names) == left and all(name.startswith(PREFIX) for name in names), names
