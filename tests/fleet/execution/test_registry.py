"""The folder with a link to each live run: whose it must be, and what becomes of links that a killed run left."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from ended_runs import LONG
from live import LiveRun
from live_directory import live_directory
from small_scenario import SMALL
from tool import invoke

from fleet.execution import registry
from fleet.execution.connection import find
from fleet.execution.directory import RunDirectory, is_in_use
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.registry import RegistryError, folder, register, registered_runs
from fleet.result.file import write_result
from fleet.result.result import Result, Status
from fleet.scenario.loading import parse_scenario


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of this test; nobody has made it yet."""
    (tmp_path / "runtime").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    return tmp_path / "runtime" / "uuv-fleet"


def test_a_run_is_registered_while_it_lives(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with a relative directory, since others look from another folder; the umask takes nothing away."""
    monkeypatch.chdir(tmp_path)
    assert registered_runs() == []
    before = os.umask(0o000)
    try:
        with live_directory(Path("runs")) as run:
            assert registered_runs() == [tmp_path / run]
            assert place.stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(before)
    assert registered_runs() == []
    assert list(place.iterdir()) == []


def test_a_run_registers_and_goes(place: Path, tmp_path: Path) -> None:
    result = execute(parse_scenario(SMALL, "small.yaml"), Options(tmp_path / "runs", in_process=True, quiet=True))
    assert not result.reason
    assert list(place.iterdir()) == []  # it was made, and is empty again
    assert not is_in_use(result.directory)


def as_a_link(place: Path) -> None:
    (place.parent / "elsewhere").mkdir(mode=0o700)
    place.symlink_to(place.parent / "elsewhere")


SPOILT: dict[str, Callable[[Path], object]] = {
    "has mode 0755, expected 0700: chmod 700": lambda place: place.mkdir(mode=0o755),
    "has mode 0770, expected 0700": lambda place: (place.mkdir(), place.chmod(0o770)),
    "is no folder; remove it": as_a_link,
    "uuv-fleet: File exists": lambda place: place.write_text(""),
}


@pytest.mark.parametrize("words", SPOILT)
def test_a_folder_that_others_can_enter_is_refused(words: str, place: Path, tmp_path: Path) -> None:
    """Nothing is read from it and nothing written to it."""
    SPOILT[words](place)
    directory = RunDirectory(tmp_path / "runs", "paper", 1)
    directory.write_scenario("")
    with pytest.raises(RegistryError, match=words):
        register(directory)
    with pytest.raises(RegistryError):
        registered_runs()
    directory.close()
    assert list(tmp_path.glob("runtime/*/*")) == []


def test_a_folder_of_another_user_is_refused(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Below /tmp somebody else may have made it first."""
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr(registry, "FALLBACK", tmp_path)
    assert folder() == tmp_path / f"uuv-fleet-{os.getuid()}"
    folder().mkdir(mode=0o700)
    with live_directory(tmp_path / "runs") as run:
        assert registered_runs() == [run]
        stranger = os.getuid() + 1
        folder().rename(tmp_path / f"uuv-fleet-{stranger}")
        monkeypatch.setattr("os.getuid", lambda: stranger)
        with pytest.raises(RegistryError, match="belongs to another user"):
            registered_runs()


@pytest.mark.parametrize("value", ["", "relative", "/proc/1/nothing"])
def test_without_a_runtime_directory_there_is_another_place(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", value)
    assert folder() == Path(f"/tmp/uuv-fleet-{os.getuid()}")


def test_a_run_goes_on_without_a_registry(place: Path, tmp_path: Path) -> None:
    """It says so once, and is found by its directory."""
    place.mkdir(mode=0o755)
    with LiveRun(tmp_path / "runs", "paper", *LONG).until_running() as run:
        assert run.said.count("the run is not registered: ") == 1, run.said
        assert f"commands find it with --run {tmp_path / 'runs' / run.directory.name}" in run.said
        assert find(str(run.directory)).directory == run.directory
        with pytest.raises(RegistryError, match="expected 0700"):
            find()


def test_links_of_runs_that_are_over_are_removed_with_their_passwords(place: Path, tmp_path: Path) -> None:
    """It does not matter whether there is a process with the number that the run had."""
    with live_directory(tmp_path, "dead", pid=os.getpid()) as dead, live_directory(tmp_path, "alive") as alive:
        lost = dead / "scenario.yaml"
        os.rename(lost, tmp_path / "kept")  # as if the console had been killed: nobody holds a lock there
        lost.write_text("")
        (dead / "join-2.json").write_text("{}")
        (place / "gone").symlink_to(tmp_path / "nowhere")
        (place / "loop").symlink_to(place / "loop")
        (place / "note.txt").write_text("not ours")
        assert registered_runs() == [alive]
        assert [path.readlink() for path in place.iterdir() if path.is_symlink()] == [alive]
        assert (place / "note.txt").exists()
        assert {path.name for path in dead.iterdir()} == {"scenario.yaml", "log"}
        assert (alive / "connection.json").exists()


def test_without_locks_a_run_is_not_registered_and_not_taken_for_dead(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on some network file systems: whoever looks must not take its connection file away, nor prune it."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    directory = RunDirectory(tmp_path / "runs", "paper", 1)
    directory.write_scenario("")
    with pytest.raises(RegistryError, match="has no locks"):
        register(directory)
    assert not place.exists()
    assert is_in_use(directory.path)
    write_result(Result(status=Status.PASS), directory.path)
    assert not is_in_use(directory.path)
    directory.close()


def test_a_run_is_found_from_any_folder_and_kill_9_leaves_no_ghost(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The real thing: a run is asked from elsewhere; its console is killed, and nothing says any more that it lives."""
    monkeypatch.chdir("/")
    with LiveRun(tmp_path / "runs", "paper", *LONG).until_running() as run:
        said = invoke("inject", "mute", 3, "--for", "1 s")
        assert said.stdout.startswith(f"{run.directory.name}: live-1: mute 3, from t = "), said.output
        refused = invoke("inject", "kill", 9, "--run", "pap")
        assert (refused.exit_code, "there is no vehicle 9" in refused.stderr) == (2, True)
        run.send(9)
        run.until_nobody_is_left()
        assert not is_in_use(run.directory)
        assert invoke("ls").stdout == ""
        assert invoke("status").exit_code == 3
        assert list(place.iterdir()) == []
        assert not (run.directory / "connection.json").exists()
