"""What the page's server does, without a browser: who may act, and a browser that is too slow."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from fleet.errors import FleetError
from fleet.view.live_feed import LiveFeed
from fleet.view.page import MOST_AHEAD, TRY_AGAIN, Page, Viewer


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
    assert feed.asked == page.commands == []


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
