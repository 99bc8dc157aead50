"""Private folders: for this user only, and gone soon after their owner, however it ended."""

from __future__ import annotations

import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from repository import ROOT

import netem.private_folder
from netem.private_folder import LOCK, PREFIX, PrivateFolder, sweep

OWNER = """
import os, signal
from netem.private_folder import PrivateFolder
folder = PrivateFolder("test")
(folder.path / "deep").mkdir()
(folder.path / "deep" / "file").touch()
print(folder.path, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """All places that are swept."""
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    monkeypatch.setattr(netem.private_folder, "SHORT", str(place))
    return place


def left(place: Path) -> Path:
    """The folder of an owner that was killed."""
    environment = os.environ | {"TMPDIR": str(place), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", OWNER], env=environment, capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    return Path(done.stdout.strip())


def test_the_folder_of_the_system_for_this_user_is_swept_too(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "runtime"
    other.mkdir()
    found = left(other)
    sweep()
    assert found.exists()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(other))
    sweep()
    assert not found.exists()


def test_it_is_for_this_user_only_and_ends_with_its_context(place: Path) -> None:
    with PrivateFolder("test") as folder:
        assert folder.parent == place
        assert folder.name.startswith(f"{PREFIX}test-")
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        (folder / "file").touch()
        sweep()
        assert (folder / "file").exists()
    assert not list(place.iterdir())


def test_a_pipe_with_the_name_of_a_folder_holds_nobody_up(place: Path) -> None:
    """In /tmp a stranger may make one, and to open it without its writer would wait for ever."""
    os.mkfifo(place / f"{PREFIX}pipe")
    sweep()
    assert (place / f"{PREFIX}pipe").exists()


def test_what_a_killed_owner_left_is_removed_when_the_next_is_made(place: Path) -> None:
    found = left(place)
    assert (found / "deep" / "file").exists()
    with PrivateFolder() as other:
        assert list(place.iterdir()) == [other]


def test_what_was_killed_while_it_was_made_goes_after_a_while(place: Path) -> None:
    """It has no lock. One that is new may be in the making; others may be on a disk without locks."""
    for name, age_s, files in (("old", 99, [f"{LOCK}.new"]), ("new", 0, [f"{LOCK}.new"]), ("full", 99, ["file"])):
        folder = place / f"{PREFIX}{name}"
        folder.mkdir()
        for file in files:
            (folder / file).touch()
        changed = folder.stat().st_mtime - age_s
        os.utime(folder, (changed, changed))
    sweep()
    assert sorted(path.name for path in place.iterdir()) == [f"{PREFIX}full", f"{PREFIX}new"]


def test_the_lock_is_removed_last(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the rest of a folder whose owner is killed while it removes it would stay for ever."""
    folder = PrivateFolder()
    (folder.path / "deep").mkdir()
    (folder.path / "file").touch()
    seen: list[list[str]] = []
    rmtree = netem.private_folder.shutil.rmtree
    monkeypatch.setattr(
        netem.private_folder.shutil,
        "rmtree",
        lambda path, **rest: (seen.append(sorted(os.listdir(folder.path))), rmtree(path, **rest)),
    )
    folder.close()
    assert seen[-1] == [LOCK] and not list(place.iterdir())


def test_a_child_that_has_the_lock_owns_it_too(place: Path) -> None:
    folder = PrivateFolder()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=(folder.lock,)) as child:
        os.close(folder.lock)
        folder.lock = -1  # as if this process had been killed
        sweep()
        assert folder.path.exists()
        child.kill()
        child.wait()
        sweep()
        assert not folder.path.exists()


def test_what_is_no_leftover_stays(place: Path) -> None:
    """Folders of somebody else's making, and links to what must not be removed."""
    other, link, within, pipe = (place / f"{PREFIX}{name}" for name in ("other", "link", "within", "pipe"))
    target = place / "target"
    for folder in (other, within, pipe, target):
        folder.mkdir()
    (target / LOCK).touch()
    link.symlink_to(target)
    (within / LOCK).symlink_to(target / LOCK)
    os.mkfifo(pipe / LOCK)
    sweep()
    assert {path.name for path in place.iterdir()} == {path.name for path in (other, link, within, pipe, target)}
    assert (target / LOCK).exists()


def test_a_link_within_a_leftover_is_not_followed(place: Path) -> None:
    found, target = left(place), place / "target"
    target.mkdir()
    (target / "file").touch()
    (found / "link").symlink_to(target)
    sweep()
    assert not found.exists()
    assert (target / "file").exists()


def test_another_users_leftover_stays(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = left(place)
    monkeypatch.setattr(netem.private_folder.os, "geteuid", lambda: os.getuid() + 1)
    sweep()
    assert found.exists()


def test_a_file_system_without_locks(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder can be used, and is removed by its owner alone."""

    def refused(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(netem.private_folder.fcntl, "flock", refused)
    with PrivateFolder() as folder:
        assert list(folder.iterdir()) == []
        monkeypatch.undo()
        monkeypatch.setattr(tempfile, "tempdir", str(place))
        sweep()
        assert folder.exists()
    assert not folder.exists()


def test_every_folder_for_a_while_is_a_private_one() -> None:
    """Whoever makes another kind leaves it behind when it is killed, as benchmarks did."""
    paths = [path for package in ("netem", "world", "agents", "fleet") for path in (ROOT / package).rglob("*.py")]
    makers = [path.name for path in paths if re.search(r"TemporaryDirectory|mkdtemp", path.read_text("utf-8"))]
    assert makers == ["private_folder.py"]
