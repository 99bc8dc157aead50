"""The count of messages that zenoh lost is a count, not a promise."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from fleet.errors import RunBroken
from fleet.execution.console import lost_messages

WHOLE: dict[str, Any] = {
    "world": {"sent": {"nav": 400, "round": 10, "frame": 20}, "received": {"cmd": 400}},
    "netem": {"sent": {"links": 11}, "received": {"round": 10}},
    "console": {"frame": 20, "links": 11},
}


def test_nothing_is_lost_when_all_counts_agree() -> None:
    assert lost_messages(WHOLE) == 0


@pytest.mark.parametrize(
    "path", [("world", "received", "cmd"), ("netem", "received", "round"), ("console", "frame"), ("console", "links")]
)
def test_a_message_missing_anywhere_is_counted(path: tuple[str, ...]) -> None:
    counts = deepcopy(WHOLE)
    *folders, name = path
    place = counts
    for folder in folders:
        place = place[folder]
    place[name] -= 2
    assert lost_messages(counts) == 2


def test_a_process_that_does_not_tell_is_no_zero() -> None:
    counts = deepcopy(WHOLE)
    counts["netem"] = {}
    with pytest.raises(RunBroken, match="count of"):
        lost_messages(counts)
