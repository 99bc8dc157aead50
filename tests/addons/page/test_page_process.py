"""The page of a run that `fleet run --view` opens."""

from __future__ import annotations

from pathlib import Path
from queue import Queue

from in_process_runs import Alone, log_of

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.page_process import _feed_of


def test_a_run_that_is_over_before_it_was_seen_is_shown_as_its_log(alone: Alone) -> None:
    told: Queue[Path] = Queue()
    directory = log_of(alone("paper", "duration=2 s", "checks={}")).parent
    told.put(directory)  # its journal can be read,
    told.put(directory)  # it is over
    feed = _feed_of(told)
    assert isinstance(feed, LogFeed) and feed.end_s == 2.0
