"""The page in a real browser: seen, clicked and typed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from browser import browser, served, tab
from in_process_runs import Alone, log_of
from live import LiveRun
from tool import tool
from waiting import wait_for

from fleet.view.server import Browser

pytestmark = pytest.mark.slow

SOON_S = 20.0
LONG = ("paper", "--publish", "--speed", "1", "--duration", "300 s", "--set", "checks={}")


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    with browser() as found:
        yield found


def test_a_click_on_a_link_cuts_it_and_another_viewer_heals_it(opened: Any, tmp_path: Path) -> None:
    with LiveRun(tmp_path, *LONG).until_running() as run, served(str(run.directory)) as address:
        one, two = tab(opened, address), tab(opened, address)
        began = one.time_s()
        wait_for(lambda: one.time_s() > began, SOON_S, "a later time")

        one.page.get_by_role("button", name="Pause").click()
        one.page.get_by_role("button", name="Resume").wait_for()
        assert "paused" in tool(tmp_path, "status").stdout

        one.page.mouse.click(*one.link(1, 2))
        one.page.get_by_text("Link from vehicle 1 to vehicle 2").wait_for()
        typed = one.page.get_by_label("Fault, in the words of fleet inject")
        assert typed.input_value() == "down 1->2"
        typed.fill("down 1->9")
        one.page.get_by_role("alert").get_by_text("1->9").wait_for()
        assert one.page.get_by_role("button", name="Inject").is_disabled()
        typed.fill("down 1->2")
        one.page.get_by_text(f"fleet inject down '1->2' --run {run.directory.name}").first.wait_for()
        one.page.get_by_role("button", name="Inject").click()

        for page in (one, two):
            page.page.locator(".fleet-faults").get_by_text("down 1->2").wait_for()
        assert "down 1->2" in tool(tmp_path, "faults").stdout

        two.page.get_by_role("button", name="Resume").click()
        two.page.get_by_role("button", name="Heal live-1").click()
        wait_for(lambda: "over" in tool(tmp_path, "faults").stdout, SOON_S, "the end of the fault")
        one.page.locator(".fleet-faults").get_by_text("no fault").wait_for()
        one.page.locator(".fleet-commands").get_by_text("fleet heal live-1").wait_for()

        one.page.get_by_role("heading", name="Checks, so far").wait_for()
        one.page.locator(".fleet-checks .pass").get_by_text("deaths").wait_for()

        tool(tmp_path, "stop")
        one.page.locator(".fleet-rate").get_by_text("the run is over").wait_for()
        assert one.wrong == two.wrong == []


def assert_nobody_gets_in_without_the_token(address: str) -> None:
    bare = address.partition("?")[0]
    for path in ("", "?token=wrong", "_nicegui/3/static/nicegui.js"):
        with pytest.raises(HTTPError) as caught:
            urlopen(bare + path)
        assert caught.value.code == 403
        caught.value.close()


def test_a_log_is_played_and_searched(opened: Any, alone: Alone) -> None:
    log = log_of(alone("paper", "duration=20 s", "faults=[{at: 5 s, for: 3 s, partition: halves}]", "checks={}"))
    with served(str(log)) as address:
        assert_nobody_gets_in_without_the_token(address)
        with closing(Browser(address)) as led:  # as `fleet view` opens it: from a file of this user
            page = tab(opened, address, led.file.as_uri())
        page.page.get_by_role("button", name="Next fault").click()
        wait_for(lambda: page.time_s() == 5.0, SOON_S, "the beginning of the fault")
        page.page.locator(".fleet-faults").get_by_text("partition").wait_for()
        slider = page.page.get_by_label("Time in the log [s]")
        slider.focus()
        slider.press("Home")
        wait_for(lambda: page.time_s() == 0.0, SOON_S, "the beginning of the log")
        page.page.get_by_role("button", name="Play").press("Enter")
        wait_for(lambda: page.time_s() > 0.3, SOON_S, "a later time")
        page.page.get_by_role("button", name="1 ★").click()
        page.page.locator(".fleet-detail").get_by_text("commands: surge").get_by_text("N m").wait_for()
        page.page.get_by_role("heading", name="Checks, of the whole run").wait_for()
        picture = page.page.get_by_role("img", name="The fleet and its links")
        picture.press("t")
        page.page.get_by_role("button", name="In 3D").wait_for()
        chosen = page.page.get_by_label("Signal to show")
        chosen.fill("uuv/1/state.z")
        chosen.press("Enter")
        page.page.locator(".fleet-chart-unit").get_by_text("now 5.").wait_for()
        assert page.wrong == []
