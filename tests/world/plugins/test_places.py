"""Where the code of a user lies, as messages say it."""

from __future__ import annotations

from pathlib import Path

import pytest

from world.plugins.error_place import shown_path


def test_paths_below_the_current_directory_are_relative(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here := tmp_path / "here").mkdir()
    monkeypatch.chdir(here)
    assert shown_path(str(here / "laws" / "mine.py")) == str(Path("laws", "mine.py"))
    assert shown_path(elsewhere := str(tmp_path / "other.py")) == elsewhere
