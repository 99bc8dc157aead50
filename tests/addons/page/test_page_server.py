"""What the page's server does, without a browser: who may act, and a browser that is too slow."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from types import SimpleNamespace
from typing import Any

import pytest
from small_scenario import small

from fleet.addons.page.chart_signals import commands_of
from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.page import MOST_AHEAD, MOST_COMMANDS, TRY_AGAIN, Page, Viewer
from fleet.addons.page.view_state import ViewState
from fleet.errors import FleetError
from fleet.logs.fault_intervals import FaultMessage
from fleet.scenario.sections.fault_entry import vehicle_entry


class AskedFeed(LiveFeed):
    """A live run without a run: it keeps what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.source: Any = SimpleNamespace(awaited=False)
        self._run: Any = object()

    def ask(self, op: str, **fields: Any) -> dict[str, Any]:
        self.asked.append(op)
        return {}


def viewer_of(page: Page, **more: Any) -> Any:
    """A browser that shows a page, with no more than it needs here."""
    viewer: Any = object.__new__(Viewer)
    vars(viewer).update(_page=page, signals={}, **more)
    return viewer


@pytest.mark.parametrize("op", ["inject", "heal", "clock"])
def test_a_page_that_may_only_watch_asks_the_console_for_nothing(op: str) -> None:
    feed = AskedFeed()
    page = Page(feed, may_act=False)
    with pytest.raises(FleetError, match="only watch"):
        asyncio.run(page.do(f"fleet {op}", op))
    assert feed.asked == list(page.commands) == []


def test_a_page_that_may_only_watch_saves_no_scenario() -> None:
    page = Page(AskedFeed(), may_act=False)
    viewer = viewer_of(page)
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
        self.signals: Any = SimpleNamespace(by_name=("a", "b", *commands_of(1)), names_of=self.meant)
        self.picture: Any = SimpleNamespace(history=dict)
        self.followed: list[set[str]] = []

    def meant(self, name: str) -> list[str]:
        return ["a", "b"] if name == "all" else [name]

    def follow(self, names: Collection[str]) -> None:
        if not set(names) <= set(self.signals.by_name):
            raise KeyError
        self.followed.append(set(names))


def test_signals_are_followed_as_long_as_a_page_shows_them() -> None:
    feed = FollowedFeed()
    page = Page(feed, may_act=False)

    def opened() -> Any:
        viewer = viewer_of(page, _ready=False)
        page._viewers.append(viewer)
        return viewer

    def does(viewer: Any, **said: Any) -> set[str]:
        asyncio.run(viewer._do(said))
        return feed.followed[-1]

    one, two = opened(), opened()
    assert does(one, do="charts", names=["a"]) == {"a"}
    assert does(two, do="charts", names=["b"]) == {"a", "b"}
    assert does(one, do="columns", names=["all"]) == {"a", "b"}
    does(one, do="columns", names=[])
    assert does(one, do="commands", i=1) == {"a", "b", *commands_of(1)}
    with pytest.raises(KeyError):
        does(one, do="charts", names=["none"])
    assert does(one, do="commands", i=0) == {"a", "b"}
    assert does(one, do="charts", names=["b"]) == {"b"}
    asked = len(feed.followed)
    does(two, do="charts", names=[])
    assert len(feed.followed) == asked  # the other one shows it
    page._forget(one)
    assert feed.followed[-1] == set()


def test_the_curves_of_the_newest_question_are_given_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page asks for the curves of a log when it opens, and for those of its signals while these are looked up."""
    feed: Any = object.__new__(LogFeed)
    feed.whole = list
    given: list[list[str]] = []
    element = SimpleNamespace(give=lambda changes: given.append(changes["whole"]))
    viewer = viewer_of(Page(feed, may_act=False), _ready=True, element=element)

    async def ask_twice() -> None:
        begun: list[asyncio.Event] = []

        async def looked_up(whole: Any, names: list[str]) -> Any:
            begun.append(asyncio.Event())
            await begun[-1].wait()
            return whole(names)

        monkeypatch.setattr("fleet.addons.page.page.run.io_bound", looked_up)
        opening = asyncio.create_task(viewer._give_whole())
        await asyncio.sleep(0)
        viewer.signals = {"charts": ["belief.nees"]}
        choosing = asyncio.create_task(viewer._give_whole())
        while not (opening.done() and choosing.done()):
            await asyncio.sleep(0)
            for one in reversed(begun):  # the newest is ready first
                if not one.is_set():
                    one.set()
                    break

    asyncio.run(ask_twice())
    assert given == [[], ["belief.nees"]]


def test_with_credentials_to_watch_only_nothing_can_be_done_either() -> None:
    feed = AskedFeed()
    feed._run = None
    assert not Page(feed, may_act=True).may_act
    feed.source.awaited = True  # its console will answer
    assert Page(feed, may_act=True).may_act


def test_pictures_do_not_pile_up_for_a_browser_that_does_not_take_them() -> None:
    feed = AskedFeed()
    feed.picture = ViewState(small())
    page = Page(feed, may_act=False)
    given: list[Any] = []
    counts = {"_sent": 0, "_seen": 0, "_left_out": 0, "_slow_until": 0.0, "_told": -1}
    viewer = viewer_of(page, _ready=True, element=SimpleNamespace(give=given.append), **counts)
    for _ in range(1000):
        viewer.show({"t": 0.0})
    left_out = 1000 - MOST_AHEAD - 1
    assert "known" in given.pop(0)  # the faults, once
    assert len(given) == MOST_AHEAD + 1 + left_out // TRY_AGAIN
    assert not given[0]["frame"]["slow"] and given[-1]["frame"]["slow"]
    viewer._seen = viewer._sent  # it has caught up
    viewer.show({"t": 1.0})
    assert given[-1]["frame"]["t"] == 1.0
    feed.picture.event(0.1, FaultMessage("live-1", "begins", "mute 1", vehicle_entry("mute", 1)))
    viewer.show({"t": 1.1})
    assert [row["id"] for row in given[-2]["known"]["faults"]] == ["live-1"]
