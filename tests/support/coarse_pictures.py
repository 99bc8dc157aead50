"""Pictures of few dots, for tests of what is drawn and where it is written."""

from __future__ import annotations

import pytest


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of pictures have 30 dots per inch in place of 300, since most of the time goes into dots."""
    monkeypatch.setattr("fleet.addons.pictures.style.DPI", 30)
    monkeypatch.setattr("fleet.addons.pictures.page.DPI", 30)
