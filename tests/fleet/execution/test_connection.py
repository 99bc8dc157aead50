"""Which live run is meant by a name, and what is said when that is not clear."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from live_directory import live_directory

from fleet.execution.connection import RemoteError, choose, find, is_live, live_runs
from fleet.execution.directory import CONNECTION, OBSERVE, RunDirectory


@pytest.fixture
def three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Path]]:
    """Live runs: two of scenario paper below different folders, and one of paper-disturbed."""
    (tmp_path / "runtime").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setattr("time.strftime", lambda *_: "20261122-120000")
    with ExitStack() as stack:
        yield {
            key: stack.enter_context(live_directory(tmp_path / out, scenario))
            for key, out, scenario in (("a", "a", "paper"), ("b", "b", "paper"), ("c", "b", "paper-disturbed"))
        }


def test_one_live_run_needs_no_name(tmp_path: Path) -> None:
    with live_directory(tmp_path) as run:
        found = find()
        assert (found.directory, found.name) == (run, run.name)
        assert "password" not in repr(found)
        assert is_live(found)
    assert not is_live(found)
    with pytest.raises(RemoteError, match="no live run") as caught:
        find()
    assert caught.value.status == 3


def test_several_need_one_and_are_listed_with_what_to_type(three: dict[str, Path]) -> None:
    with pytest.raises(RemoteError) as caught:
        find()
    assert caught.value.status == 2
    assert str(caught.value).splitlines() == [
        "3 live runs; say which:",
        f"  --run {three['a']}",  # its name is not unique
        f"  --run {three['b']}",
        "  --run paper-disturbed-1-20261122-120000",
    ]
    assert [run.directory for run in live_runs()] == [three["a"], three["b"], three["c"]]


def test_names_scenarios_and_beginnings(three: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("paper-disturbed-1-20261122-120000", "paper-disturbed", "paper-d", "paper-disturbed-1-2026"):
        assert find(name).directory == three["c"], name
    monkeypatch.chdir(three["a"].parent)
    for directory in (str(three["a"]), three["a"].name, "latest", "./latest", f"../a/{three['a'].name}"):
        assert find(directory).directory == three["a"], directory
    assert find("paper").directory == three["a"]  # the only one here
    monkeypatch.chdir("/")
    for name, count in (("paper", 2), ("pap", 3), ("", 3)):
        with pytest.raises(RemoteError, match=f"{count} live runs that '{name}' may mean; say which:") as caught:
            find(name)
        assert caught.value.status == 2


def test_the_run_below_the_working_directory_is_meant(
    three: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault hit a run of another trial, or was refused although one run only was at hand."""
    with live_directory(tmp_path / "trial" / "runs") as ours:
        monkeypatch.chdir(tmp_path / "trial")
        for name in (None, "pap"):
            assert find(name, to_act=True).directory == find(name).directory == ours, name
        with live_directory(tmp_path / "trial" / "others"):
            assert find(to_act=True).directory == ours
    for folder in (tmp_path / "trial", tmp_path / "trial" / "runs"):
        monkeypatch.chdir(folder)
        with pytest.raises(RemoteError, match=f"no live run is below {folder}; one that is elsewhere") as caught:
            find(to_act=True)
        assert caught.value.status == 2
        assert str(caught.value).count("--run") == 3
    monkeypatch.chdir(three["a"].parent)
    assert find(to_act=True).directory == three["a"]


def test_one_run_elsewhere_is_shown_and_not_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "empty").mkdir()
    with live_directory(tmp_path / "other") as run:
        monkeypatch.chdir(tmp_path / "empty")
        assert find().directory == run
        with pytest.raises(RemoteError, match="has to be named"):
            find(to_act=True)
        assert find(run.name, to_act=True).directory == run
        (tmp_path / "empty").rmdir()
        assert find().directory == run


@pytest.mark.parametrize("name", ["rough-sea", "a/b", "/", "/root/x", "x" * 5000, "a\0b", "*", "paper-disturbed-2"])
def test_what_no_run_is_called(name: str, three: dict[str, Path]) -> None:
    with pytest.raises(RemoteError, match=r"no live run") as caught:
        find(name)
    assert caught.value.status == 3


def test_a_run_that_is_over_says_so(tmp_path: Path) -> None:
    """A connection file that a killed run left, and none."""
    left = RunDirectory(tmp_path, "paper", 1)
    left.write_scenario("")
    left.write_connection({})
    left.close()
    with pytest.raises(RemoteError, match="is over: its console is gone"):
        find(str(left.path))
    left.connection.unlink()
    with pytest.raises(RemoteError, match=r"is no live run: there is no connection\.json"):
        find(str(left.path))


def test_a_live_run_with_a_damaged_file_is_none(tmp_path: Path) -> None:
    with live_directory(tmp_path, pid=-1):
        assert live_runs() == []
        with pytest.raises(RemoteError, match=r"there is no usable connection\.json"):
            find()


def test_a_run_is_chosen_by_what_is_asked_of_it(tmp_path: Path) -> None:
    """One that nobody can ask may be recorded, and the other way round."""
    with live_directory(tmp_path) as asked, live_directory(tmp_path) as published:
        (published / CONNECTION).unlink()
        (published / OBSERVE).write_text("{}")
        assert choose(None, CONNECTION) == asked
        assert choose("paper", OBSERVE) == published
