"""What a viewer is to show is found by name, from any folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from os import utime
from pathlib import Path

import pytest
from live_directory import live_directory
from traffic import log as log

from fleet.addons.page.source import LiveSource, LogSource, find_source
from fleet.errors import FleetError
from fleet.execution.connection import RemoteError
from fleet.execution.directory import CONNECTION, OBSERVE
from fleet.replay.observed import Observed, write_observed

OBSERVED = Observed("tcp/127.0.0.1:1", "observer", "secret", "0123abcd")


@pytest.fixture(autouse=True)
def _registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@contextmanager
def published(out: Path, scenario: str = "paper", began_s: float = 1e9) -> Iterator[Path]:
    with live_directory(out, scenario) as directory:
        write_observed(directory / OBSERVE, OBSERVED)
        utime(directory / "scenario.yaml", (began_s, began_s))
        yield directory


def test_a_live_run_by_name_or_the_one_that_began_last(tmp_path: Path) -> None:
    """With what asks its console, unless only the observer's part can be read."""
    with published(tmp_path / "a", "paper", 2e9) as paper, published(tmp_path / "b", "ideal") as ideal:
        for name in (None, "paper", paper.name, str(paper)):
            found = find_source(name, tmp_path)
            assert isinstance(found, LiveSource) and found.directory == paper
            assert found.observed == OBSERVED and found.run is not None
        assert find_source("ideal", tmp_path).directory == ideal
        only = find_source(str(paper / OBSERVE), tmp_path)
        assert isinstance(only, LiveSource) and only.run is not None
        copy = shutil.copy(paper / OBSERVE, tmp_path / "given.json")
        given = find_source(str(copy), tmp_path)
        assert isinstance(given, LiveSource) and given.run is None
        (paper / CONNECTION).unlink()
        watched = find_source("paper", tmp_path)
        assert isinstance(watched, LiveSource) and watched.run is None


def test_a_run_of_another_folder_has_to_be_named(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page may disturb a run, and one elsewhere may be of another trial. Before, the newest of all was opened."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    with published(tmp_path / "elsewhere", "ideal", 2e9) as theirs:
        with pytest.raises(FleetError, match=f"no live run is below .*name one that is elsewhere: {theirs}"):
            find_source(None, Path("runs"))
        assert find_source(None, log.parents[1]) == LogSource(log)
        with published(here / "runs", "paper", 1e9) as ours:
            assert find_source(None, Path("runs")).directory == ours  # type: ignore[union-attr]
        assert find_source("ideal", Path("runs")).directory == theirs  # type: ignore[union-attr]


def test_several_runs_of_a_name(tmp_path: Path) -> None:
    with published(tmp_path / "a"), published(tmp_path / "b"), pytest.raises(RemoteError, match="2 live runs"):
        find_source("paper", tmp_path)


def test_logs(log: Path, tmp_path: Path) -> None:
    """A file, the directory of a run that is over, or the newest run below a folder."""
    assert find_source(str(log), tmp_path) == LogSource(log)
    assert find_source(str(log.parent), tmp_path) == LogSource(log)
    assert find_source(None, log.parents[1]) == LogSource(log)


def test_nothing_to_show(tmp_path: Path) -> None:
    """Said with what to do."""
    with pytest.raises(FleetError, match="fleet run paper --publish"):
        find_source(None, tmp_path)
    with pytest.raises(FleetError, match="no live run is called 'x'; there is none at all; nor is it a file"):
        find_source("x", tmp_path)
    with live_directory(tmp_path / "a") as directory:
        for name in (None, str(directory), "paper", directory.name):
            with pytest.raises(FleetError, match="is not published: start it with fleet run"):
                find_source(name, tmp_path)
    path = tmp_path / "given.json"
    path.write_bytes(b"{")
    with pytest.raises(FleetError, match=r"given\.json"):
        find_source(str(path), tmp_path)
