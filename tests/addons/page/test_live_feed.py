"""A live run as a page shows it, without a run."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from small_scenario import small

from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.source import LiveSource
from fleet.addons.page.view_state import ViewState
from fleet.logs.schemas import BELIEF, flat_schema
from fleet.recorder.scene.primitives import CrossShape
from fleet.replay.live_journal import LiveJournal, pack_counts
from fleet.replay.observed import Observed
from fleet.replay.topics import PublishedTopic
from netem.wire.keys import Keys

KEYS = Keys("x")


def journal() -> LiveJournal:
    """Of a run that is not there."""
    nothing: Any = SimpleNamespace(subscribe=lambda *_: None)
    return LiveJournal(nothing, KEYS)


def feed_of(picture: ViewState, **more: Any) -> Any:
    """A feed of such a run, with no more than it needs here."""
    feed: Any = object.__new__(LiveFeed)
    rate, signals = SimpleNamespace(value=1.0, update=lambda *_: None), SimpleNamespace(values=lambda *_: ())
    vars(feed).update(_journal=journal(), picture=picture, _rate=rate, signals=signals, _begun=False, _told={}, **more)
    return feed


def sample(topic: str, data: bytes, place: int) -> Any:
    """A sample of zenoh at time 0."""
    return SimpleNamespace(
        key_expr=KEYS.log(topic),
        attachment=SimpleNamespace(to_bytes=lambda: bytes([0x94, 0, 0, 0, 0])),
        payload=SimpleNamespace(to_bytes=lambda: data),
        source_info=SimpleNamespace(source_sn=place),
    )


def test_messages_that_did_not_come_are_said_also_when_the_run_is_over() -> None:
    feed = feed_of(ViewState(small()), _over="", _published=True, _status={})
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
    feed = feed_of(ViewState(small()))
    place = count()
    for many in (1, 6):
        for _ in range(many):
            feed._journal.receive(sample("faults", b"\xff", next(place)))
        assert feed.advance()
    assert feed.missing.count == 3


def test_who_comes_late_asks_the_console_what_was_before() -> None:
    """Ages were counted from 0: 82.9 s in place of 24. Also of a run that is paused, so that no message comes."""
    rows = [{"src": 1, "dst": 2, "age_s": 24.0}]
    asked: list[Any] = []

    def ask(op: str, **fields: Any) -> Any:
        asked.append((op, fields))
        return {"at_s": 80.0, "end_s": 90.0, "links": rows, "faults": [], "events": [], "checks": []}

    feed = feed_of(ViewState(small()), _over="", _run=object(), ask=ask)
    feed._journal.bus.connected = True
    feed.look()
    assert asked[0] == ("status", {"all": True})
    feed.advance()
    frame = feed.picture.frame()
    assert (frame["t"], frame["since"]) == (80.0, 80.0)
    k = feed.picture.setup()["links"].index([1, 2])
    assert frame["ages"][k] == 24.0 and set(frame["ages"]) == {24.0, None}
    assert frame["links"][k] == "stale"


def test_of_many_beliefs_the_newest_is_shown_and_none_is_missing() -> None:
    feed = feed_of(ViewState(small("navigation=mems")))
    message = flat_schema("Belief", BELIEF).message
    for north in (1.0, 2.0, 3.0):
        feed._journal.receive_newest(sample("uuv/2/belief", message(off=[north, 0.0, 0.0]).SerializeToString(), 0))
    assert feed.advance()
    crosses = [one for one in feed.picture.moving() if isinstance(one, CrossShape) and one.colour == "vehicle 2"]
    assert [cross.at.north for cross in crosses] == [3.0]
    assert not feed.advance()
    assert feed.missing.count == 0


def test_what_is_charted_from_the_start_is_followed_without_a_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser that came later, or came back after some seconds, had empty charts of it beside full ones."""
    scenario = small("navigation=mems", "checks={signal: [{topic: belief.nees, below: 20}]}")
    schema = flat_schema("Belief", BELIEF)
    topics = {f"uuv/{i}/belief": PublishedTopic(schema.name, schema.descriptor_set, "") for i in (1, 2)}
    monkeypatch.setattr("fleet.addons.page.live_feed.ask_scenario", lambda *_: scenario.to_yaml())
    monkeypatch.setattr("fleet.addons.page.live_feed.ask_topics", lambda *_: topics)
    followed: list[str] = []

    def subscribe(key: str, _: Any) -> Any:
        followed.append(key)
        return lambda: followed.remove(key)

    monkeypatch.setattr(LiveJournal, "connect", lambda *_: LiveJournal(SimpleNamespace(subscribe=subscribe), KEYS))
    feed = LiveFeed(LiveSource(Path("x"), Observed("", "", "", "x"), None))
    charted = {KEYS.log(topic) for topic in topics}
    assert charted <= set(followed)
    feed.follow(["uuv/1/belief.off_norm"])
    feed.follow([])
    assert charted <= set(followed) and len(followed) == len(set(followed))
    message = schema.message(nees=2.5).SerializeToString()
    feed._journal.receive(sample("uuv/2/belief", message, 0))
    assert feed.advance()
    assert feed.picture.history()["signals"]["uuv/2/belief.nees"] == [(0.0, 2.5)]
