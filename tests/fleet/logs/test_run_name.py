"""What the name of a run says."""

from __future__ import annotations

from pathlib import Path

from fleet.logs.run_name import begin_time, run_name


def test_the_time_that_the_name_of_a_run_says() -> None:
    for name in ("paper-1-20261122-062444", "paper-1-20261122-062444-2"):
        assert str(begin_time(name)) == "2026-11-22 06:24:44+00:00"
    assert [begin_time(name) for name in ("paper", "a-1-20261322-062444", "a-1-20261122-062444-x")] == [None] * 3


def test_a_run_is_called_as_its_directory_is_and_a_log_elsewhere_as_its_file(tmp_path: Path) -> None:
    (tmp_path / "paper-1-x").mkdir()
    (tmp_path / "latest").symlink_to("paper-1-x")
    (tmp_path / "loop").symlink_to("loop")
    assert run_name(tmp_path / "latest" / "run.mcap") == "paper-1-x"
    assert run_name(tmp_path / "latest" / "copy.mcap") == "copy"
    assert run_name(tmp_path / "loop") == "loop"
