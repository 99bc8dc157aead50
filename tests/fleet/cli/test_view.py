"""`fleet view` and `fleet run --view`, as far as they go without a page."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from fleet.cli.main import cli
from fleet.view import server


def test_a_run_in_one_process_has_no_page_of_its_own(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["run", "paper", "--in-process", "--view", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "--view is of a run that answers" in result.stderr
    assert not list(tmp_path.iterdir())


def test_without_nicegui_no_run_is_started_and_nothing_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: None)
    result = CliRunner().invoke(cli, ["run", "paper", "--view", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "pip install 'uuv-fleet[view]'" in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


def test_what_is_neither_a_run_nor_a_log_is_said(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["view", str(tmp_path / "nothing"), "--no-open"])
    assert result.exit_code == 2 and "nothing" in result.stderr
    text = tmp_path / "text.mcap"
    text.write_text("no log")
    result = CliRunner().invoke(cli, ["view", str(text), "--no-open"])
    assert result.exit_code == 2 and "no MCAP log" in " ".join(result.stderr.split())
