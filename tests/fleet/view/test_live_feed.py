"""A live run as a page shows it, without a run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from in_process_runs import Alone, log_of

from fleet.view.live_feed import LiveFeed


def test_signals_are_looked_up_again_until_the_log_has_some(alone: Alone, tmp_path: Path) -> None:
    whole = Path(log_of(alone("paper", "duration=2 s", "checks={}"))).read_bytes()
    feed: Any = SimpleNamespace(log=tmp_path / "run.mcap", _known=None)
    feed.log.write_bytes(whole[:64])  # as it is before its first second is written
    assert not LiveFeed.signals(feed).by_name
    feed.log.write_bytes(whole)
    assert "uuv/1/state.z" in LiveFeed.signals(feed).by_name
