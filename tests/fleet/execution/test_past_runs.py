"""The runs below a directory: which are ours, what they came to, and which may be removed."""

from __future__ import annotations

import fcntl
import json
import os
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_directory import live_directory

from fleet.errors import FleetError
from fleet.execution.directory import RunDirectory
from fleet.execution.past_runs import (
    BROKE,
    FAIL,
    FINISHED,
    LIVE,
    PASS,
    STOPPED,
    VERDICTS,
    PastRun,
    newest_run,
    past_runs,
    remove,
    to_prune,
)

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)


def made(out: Path, name: str, status: str | None = "pass", sim_s: object = 60.0) -> Path:
    """A run directory with a log of 1000 bytes and a result."""
    path = out / name
    (path / "log").mkdir(parents=True)
    (path / "scenario.yaml").write_text("")
    (path / "run.mcap").write_bytes(bytes(1000))
    if status is not None:
        (path / "result.json").write_text(json.dumps({"status": status, "sim_s": sim_s}))
    return path


def test_what_runs_came_to(tmp_path: Path) -> None:
    cases: list[tuple[str | None, object, str, float | None]] = [
        ("pass", 60.0, PASS, 60.0),
        ("check_failed", 60.0, FAIL, 60.0),
        ("broken", 1.5, BROKE, 1.5),
        ("interrupted", 2, STOPPED, 2.0),
        ("hung_up", 2.0, STOPPED, 2.0),
        ("usage", 0.0, BROKE, None),  # of a later version
        (None, None, BROKE, None),  # killed
        ("pass", "soon", BROKE, None),  # damaged
    ]
    for hour, (status, sim_s, _, _) in enumerate(cases):
        made(tmp_path, f"my-own-7-20261122-{hour:02}0000", status, sim_s)
    with live_directory(tmp_path, "rough-sea") as live:
        found = past_runs(tmp_path)
        assert found[-len(cases) :] == sorted(found, key=lambda run: run.began, reverse=True)[-len(cases) :]
        assert [(run.verdict, run.sim_s) for run in reversed(found) if run.path != live] == [c[2:] for c in cases]
        assert [run.scenario for run in found if run.path == live] == ["rough-sea"]
        assert [run.verdict for run in found if run.path == live] == [LIVE]
    sizes = {run.size for run in found if run.path != live}
    assert all(1000 <= size < 1100 for size in sizes)


def test_what_is_not_ours_is_not_listed(tmp_path: Path) -> None:
    """Names of others, links, and directories that only have such a name."""
    ours = made(tmp_path, "paper-1-20261122-120000-2")
    made(tmp_path, "the-good-one")
    made(tmp_path, "paper-1-20269999-120000")
    (tmp_path / "paper-1-20261122-130000").symlink_to(ours.name)
    (tmp_path / "latest").symlink_to(ours.name)
    (tmp_path / "paper-1-20261122-140000").mkdir()
    (tmp_path / "paper-1-20261122-150000").write_text("")
    (ours / "elsewhere").symlink_to("/usr")  # what a link leads to is not counted
    assert [(run.path, run.size < 1100) for run in past_runs(tmp_path)] == [(ours, True)]
    assert past_runs(tmp_path / "nowhere") == []


def a_run(number: int, verdict: str, age_s: float) -> PastRun:
    return PastRun(f"paper-{number}", Path(f"paper-{number}"), "paper", verdict, None, 0, NOW, age_s)


@given(
    st.lists(st.tuples(st.sampled_from(VERDICTS), st.floats(0, 1e6)), max_size=12),
    st.integers(0, 12),
    st.floats(0, 1e6),
    st.sets(st.sampled_from(FINISHED)),
)
def test_only_what_every_condition_holds_for_goes(
    drawn: list[tuple[str, float]], keep: int, older_than_s: float, verdicts: set[str]
) -> None:
    runs = [a_run(k, verdict, age_s) for k, (verdict, age_s) in enumerate(sorted(drawn, key=lambda one: one[1]))]
    going = to_prune(runs, keep=keep, older_than_s=older_than_s, verdicts=verdicts)
    over = [run for run in runs if run.verdict != LIVE]
    for run in runs:
        goes = run in over[keep:] and run.verdict in verdicts and run.age_s >= older_than_s
        assert (run in going) == goes


def test_removal_follows_no_link_and_mends_latest(tmp_path: Path) -> None:
    old, new = made(tmp_path, "paper-1-20261120-120000"), made(tmp_path, "paper-1-20261121-120000")
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "data").write_text("1")
    (new / "link").symlink_to(precious)
    (tmp_path / "latest").symlink_to(new.name)
    runs = past_runs(tmp_path)
    assert [run.path for run in remove(tmp_path, runs[:1])] == [new]
    assert (precious / "data").read_text() == "1"
    assert os.readlink(tmp_path / "latest") == old.name
    assert [run.path for run in remove(tmp_path, runs[1:])] == [old]
    assert not (tmp_path / "latest").is_symlink()
    assert {path.name for path in tmp_path.iterdir()} == {"precious"}


def test_a_run_that_goes_on_is_not_removed(tmp_path: Path) -> None:
    """Whatever was known of it when the list was made."""
    with live_directory(tmp_path) as live:
        listed = [PastRun(live.name, live, "paper", BROKE, None, 0, NOW, 0.0)]
        assert list(remove(tmp_path, listed)) == []
        assert live.is_dir()


def test_what_cannot_be_removed_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made(tmp_path, "paper-1-20261120-120000")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("shutil.rmtree", refuse)
    with pytest.raises(FleetError, match="paper-1-20261120-120000: Permission denied"):
        list(remove(tmp_path, past_runs(tmp_path)))


def test_a_directory_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for look in (past_runs, newest_run):
        with pytest.raises(FleetError, match="Not a directory; choose another place with --out"):
            look(tmp_path / "file")


def test_the_newest_run(tmp_path: Path) -> None:
    assert newest_run(tmp_path) is None
    old, new = made(tmp_path, "paper-2-20261120-120000"), made(tmp_path, "paper-1-20261121-120000")
    assert newest_run(tmp_path) == new  # by its time, not by its name
    (tmp_path / "latest").symlink_to(old.name)
    assert newest_run(tmp_path) == old
    (tmp_path / "latest").unlink()
    (tmp_path / "latest").symlink_to("nowhere")
    assert newest_run(tmp_path) == new


def test_a_run_that_begins_is_at_no_moment_taken_for_a_dead_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`fleet ls --prune` would remove it, and who looks holds a lock for a moment."""
    seen = []
    lock = fcntl.flock

    def looking(file: IO[bytes], how: int) -> None:
        if how & fcntl.LOCK_EX:
            seen.append(past_runs(tmp_path))
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", looking)
    directory = RunDirectory(tmp_path, "paper", 1)
    with closing(directory):
        directory.write_scenario("text")
        assert seen == [[]]
        assert [run.verdict for run in past_runs(tmp_path)] == [LIVE]
        assert directory.locked
    assert (directory.path / "scenario.yaml").read_text() == "text"
