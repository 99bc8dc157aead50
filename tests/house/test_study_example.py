"""The notebook page docs/guide/study-example.md: its code runs, and prints what the page shows."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from notebook_pages import run_page
from repository import ROOT
from study_engine import Here

PAGE = ROOT / "docs" / "guide" / "study-example.md"


def test_the_notebook_page_shows_what_its_code_prints_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, in which no worker has to start."""

    @contextlib.contextmanager
    def here(*_: Any, **__: Any) -> Iterator[Here]:
        yield Here()

    monkeypatch.setattr("fleet.addons.studies.study.engine_of", here)
    monkeypatch.chdir(tmp_path)
    assert run_page(PAGE) >= 7
    for picture, drawn in (("study-passed.png", "passed"), ("study-pairs.png", "compare-controller-formation_final_m")):
        shown, made = (
            matplotlib.image.imread(path) for path in (PAGE.parent / picture, tmp_path / f"loss/plots/{drawn}.png")
        )
        assert shown.shape == made.shape
        assert np.abs(shown - made).mean() < 0.01  # other versions of matplotlib may draw an edge otherwise
