"""A live run as a page shows it, without a run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from small_scenario import small

from fleet.replay.live_journal import LiveJournal
from fleet.replay.missing import pack_counts
from fleet.view.live_feed import LiveFeed
from fleet.view.view_state import ViewState
from netem.wire.keys import Keys


def journal() -> LiveJournal:
    """Of a run that is not there."""
    nothing: Any = SimpleNamespace(subscribe=lambda *_: None)
    return LiveJournal(nothing, Keys("x"))


def test_messages_that_did_not_come_are_said_also_when_the_run_is_over() -> None:
    feed: Any = object.__new__(LiveFeed)
    vars(feed).update(_journal=journal(), picture=ViewState(small()), _over="", _published=True, _status={})
    feed._rate = SimpleNamespace(value=1.0)
    assert feed.clock()["note"] == ""
    feed.missing.came("transforms", 0)
    feed.missing.came("transforms", 3)
    assert feed.clock()["note"].startswith("2 messages were left out")
    feed.missing.end(pack_counts({"transforms": 5}))
    assert feed.clock()["note"].startswith("2 messages")  # the last one may be on its way
    feed._over = "the run is over"
    assert feed.clock()["note"].startswith("3 messages were left out")


def test_what_the_queue_has_no_room_for_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.replay.live_journal.MOST_WAITING", 3)
    feed: Any = object.__new__(LiveFeed)
    vars(feed).update(_journal=journal(), picture=ViewState(small()))
    feed._rate = SimpleNamespace(update=lambda *_: None)
    feed.signals = SimpleNamespace(values=lambda *_: ())
    stamp = SimpleNamespace(to_bytes=lambda: bytes([0x94, 0, 0, 0, 0]))
    for count in (1, 6):
        for _ in range(count):
            place = feed.__dict__["place"] = feed.__dict__.get("place", -1) + 1
            feed._journal.receive(
                SimpleNamespace(
                    key_expr=Keys("x").log("faults"),
                    attachment=stamp,
                    payload=SimpleNamespace(to_bytes=lambda: b"\xff"),
                    source_info=SimpleNamespace(source_sn=place),
                )
            )
        assert feed.advance()
    assert feed.missing.count == 3
