"""What the page's server does, without a browser: who may act, and a browser that is too slow."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from types import SimpleNamespace
from typing import Any

import pytest

from fleet.errors import FleetError
from fleet.view.live_feed import LiveFeed
from fleet.view.page import MOST_AHEAD, MOST_COMMANDS, TRY_AGAIN, Page, Viewer
from fleet.view.signals import commands_of


class AskedFeed(LiveFeed):
    """A live run without a run: it keeps what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.source: Any = SimpleNamespace(run=object())

    def ask(self, op: str, **fields: Any) -> dict[str, Any]:
        self.asked.append(op)
        return {}


@pytest.mark.parametrize("op", ["inject", "heal", "clock"])
def test_a_page_that_may_only_watch_asks_the_console_for_nothing(op: str) -> None:
    feed = AskedFeed()
    page = Page(feed, may_act=False)
    with pytest.raises(FleetError, match="only watch"):
        asyncio.run(page.do(f"fleet {op}", op))
    assert feed.asked == list(page.commands) == []


def test_a_page_that_may_only_watch_saves_no_scenario() -> None:
    page = Page(AskedFeed(), may_act=False)
    viewer: Any = object.__new__(Viewer)
    viewer._page = page
    with pytest.raises(FleetError, match="only watch"):
        asyncio.run(viewer._do({"do": "script"}))
    assert not page.commands


def test_only_the_last_commands_are_listed() -> None:
    page = Page(AskedFeed(), may_act=True)
    for n in range(MOST_COMMANDS + 5):
        page.note(f"fleet heal live-{n}")
    assert len(page.commands) == MOST_COMMANDS and page.commands[-1] == f"fleet heal live-{MOST_COMMANDS + 4}"


class FollowedFeed(AskedFeed):
    """It keeps which signals it is to follow, and knows three."""

    def __init__(self) -> None:
        super().__init__()
        self.signals: Any = SimpleNamespace(by_name=("a", "b", *commands_of(1)))
        self.picture: Any = SimpleNamespace(history=dict)
        self.followed: list[set[str]] = []

    def follow(self, names: Collection[str]) -> None:
        if not set(names) <= set(self.signals.by_name):
            raise KeyError
        self.followed.append(set(names))


def test_signals_are_followed_as_long_as_a_page_shows_them() -> None:
    feed = FollowedFeed()
    page = Page(feed, may_act=False)

    def opened() -> Any:
        viewer: Any = object.__new__(Viewer)
        vars(viewer).update(_page=page, _ready=False, signals={})
        page._viewers.append(viewer)
        return viewer

    def does(viewer: Any, **said: Any) -> set[str]:
        asyncio.run(viewer._do(said))
        return feed.followed[-1]

    one, two = opened(), opened()
    assert does(one, do="signal", name="a") == {"a"}
    assert does(two, do="signal", name="b") == {"a", "b"}
    assert does(one, do="commands", i=1) == {"a", "b", *commands_of(1)}
    with pytest.raises(KeyError):
        does(one, do="signal", name="none")
    assert does(one, do="commands", i=0) == {"a", "b"}
    assert does(one, do="signal", name="b") == {"b"}
    asked = len(feed.followed)
    does(two, do="signal", name="")
    assert len(feed.followed) == asked  # the other one shows it
    page._forget(one)
    assert feed.followed[-1] == set()


def test_with_credentials_to_watch_only_nothing_can_be_done_either() -> None:
    feed = AskedFeed()
    feed.source.run = None
    assert not Page(feed, may_act=True).may_act


def test_pictures_do_not_pile_up_for_a_browser_that_does_not_take_them() -> None:
    page = Page(AskedFeed(), may_act=False)
    given: list[Any] = []
    viewer: Any = object.__new__(Viewer)
    vars(viewer).update(
        _page=page, _ready=True, _sent=0, _seen=0, _left_out=0, element=SimpleNamespace(give=given.append)
    )
    for _ in range(1000):
        viewer.show({"t": 0.0})
    left_out = 1000 - MOST_AHEAD - 1
    assert len(given) == MOST_AHEAD + 1 + left_out // TRY_AGAIN
    assert page.dropped == left_out
    viewer._seen = viewer._sent  # it has caught up
    viewer.show({"t": 1.0})
    assert given[-1]["frame"]["t"] == 1.0
