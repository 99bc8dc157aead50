"""Where a log is, and what is said when it is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.logs.reader import LogReadError, log_path, open_file


def test_a_link_to_a_run_gives_the_run(tmp_path: Path) -> None:
    """`latest` leads elsewhere after the next run, so nothing may remember it."""
    run = tmp_path / "paper-1-20261122-120000"
    run.mkdir()
    (tmp_path / "latest").symlink_to(run.name)
    assert log_path(tmp_path / "latest") == log_path(run) == run / "run.mcap"
    (tmp_path / "elsewhere").symlink_to(run)
    assert log_path(tmp_path / "elsewhere") == run / "run.mcap"
    assert log_path(tmp_path / "some.mcap") == tmp_path / "some.mcap"


def test_a_log_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogReadError, match=r"No such file or directory; a log is an MCAP file, or the directory of a "):
        open_file(tmp_path / "latest")
