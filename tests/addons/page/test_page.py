"""The page in a real browser: seen, clicked and typed."""

from __future__ import annotations

import re
import shutil
import signal
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from browser import SOON_S, address_in, browser, served, tab
from in_process_runs import Alone, log_of
from live import LiveRun
from tool import tool
from waiting import wait_for

from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.server import Browser
from fleet.addons.page.source import find_source
from fleet.execution.directory import OBSERVE, SCENARIO
from fleet.repeat.recorded_run import script
from fleet.scenario.loading import parse_scenario

pytestmark = pytest.mark.slow

LONG = ("paper", "--publish", "--speed", "1", "--duration", "300 s", "--set", "checks={}")


# When the samples of the charts begin: formation errors, and signals that checks name.
BEGINNINGS = """() => {
    const { samples, signals } = document.querySelector(".fleet-view").fleet.charting;
    return [samples[0][0], ...signals.values().map((values) => values[0]?.[0] ?? 1e9)];
}"""


# Of the buttons that are shown: what is read out of each.
NAMES = """() => [...document.querySelectorAll(".fleet-view button")].filter((one) => one.checkVisibility())
    .map((one) => one.getAttribute("aria-label") ?? one.textContent)"""


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
        assert "down 1->2" in tool(tmp_path, "status", "--all").stdout

        two.page.get_by_role("button", name="Resume").click()
        two.page.get_by_role("button", name="Heal live-1").click()
        wait_for(lambda: "over" in tool(tmp_path, "status", "--all").stdout, SOON_S, "the end of the fault")
        one.page.locator(".fleet-faults").get_by_text("no fault").wait_for()
        one.page.locator(".fleet-commands").get_by_text("fleet heal live-1").wait_for()

        wait_for(lambda: "1->2" in script(run.log).to_yaml(), SOON_S, "the fault in the log")
        with one.page.expect_download() as saved:
            one.page.get_by_role("button", name="Save as scenario").click()
        again = parse_scenario(Path(saved.value.path()).read_text(), "again.yaml")
        assert "1->2" in again.to_yaml()  # the run goes on, so its log says more by now
        two.page.locator(".fleet-commands").get_by_text("fleet export").wait_for()

        one.page.get_by_role("heading", name="Checks, so far").wait_for()
        one.page.locator(".fleet-checks .pass").get_by_text("deaths").wait_for()

        given = Path(shutil.copy(run.directory / OBSERVE, tmp_path / "given.json"))
        watched = find_source(str(given), tmp_path)  # what an observer has, and nothing else
        with closing(LiveFeed(watched)) as feed:
            assert feed.scenario.to_yaml() == (run.directory / SCENARIO).read_text()
            feed.follow({"uuv/1/state.z"})
            wait_for(lambda: feed.advance() and feed.picture.history()["signals"]["uuv/1/state.z"], SOON_S, "a value")
            assert feed.signals.units["uuv/1/state.z"] == "m"
            feed.follow(())
            assert not feed._ends and not feed.picture.history()["signals"]

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


def test_a_log_of_a_hundred_vehicles_is_played_and_searched(opened: Any, alone: Alone) -> None:
    settings = (
        "vehicles=100",
        "duration=2 s",
        "faults=[{at: 1 s, for: 500 ms, partition: halves}]",
    )
    with served(str(log_of(alone("paper", *settings, "checks={tumbled: waived}")))) as address:
        assert_nobody_gets_in_without_the_token(address)
        with closing(Browser(address)) as led:  # as `fleet view` opens it: from a file of this user
            page = tab(opened, address, led.file.as_uri())
        page.page.get_by_role("button", name="Next fault").click()
        wait_for(lambda: page.time_s() == 1.0, SOON_S, "the beginning of the fault")
        page.page.locator(".fleet-faults").get_by_text("partition").wait_for()
        assert len(page.vehicles()) == page.page.locator(".fleet-side tbody tr").count() == 100
        slider = page.page.get_by_label("Time in the log [s]")
        slider.focus()
        slider.press("Home")
        wait_for(lambda: page.time_s() == 0.0, SOON_S, "the beginning of the log")
        picture = page.page.get_by_role("img", name="The fleet and its links")
        page.page.get_by_label("Rate", exact=True).select_option("0.25")
        slider.press("Space")  # belongs to the field
        picture.press("Space")
        page.page.get_by_role("button", name="Pause").press("Enter")
        page.page.get_by_role("button", name="Play").press("Enter")
        wait_for(lambda: page.time_s() > 0.3, SOON_S, "a later time")
        page.page.get_by_role("button", name="1 ★", exact=True).click()
        page.page.locator(".fleet-detail").get_by_text("commands: surge").get_by_text("N m").wait_for()
        page.page.get_by_role("heading", name="Checks, of the whole run").wait_for()
        picture.press("t")
        page.page.get_by_role("button", name="In 3D").wait_for()
        page.page.get_by_label("Signal to add as a column").fill("command.tau_0")
        page.page.get_by_label("Signal to add as a column").press("Enter")
        page.page.get_by_role("button", name="command.tau_0", exact=True).wait_for()
        find = page.page.get_by_label("Find links by vehicle, ends or state")
        find.fill("7->")
        page.page.locator(".fleet-links").get_by_role("button", name="7 → 8:").wait_for()
        find.press("Tab")
        page.page.keyboard.press("ArrowDown")
        assert page.page.evaluate("document.activeElement.textContent").startswith("7 → ")
        names = page.page.evaluate(NAMES)
        assert len(names) > 100 and len(set(names)) == len(names), sorted(names)
        chosen = page.page.get_by_label("Signal to show")
        chosen.fill("uuv/100/state.z")
        chosen.press("Enter")
        page.page.locator(".fleet-chart-unit").get_by_text(re.compile(r"now -?[\d.]+ m$")).wait_for()
        assert page.page.locator(".fleet-reading").count() == 0
        page.page.get_by_role("button", name="Go on from here").click()
        command = page.page.get_by_label("Text to copy").input_value()
        assert re.fullmatch(r"fleet run --from \S+@[\d.]+s", command)
        assert page.wrong == []


def test_who_comes_later_sees_the_same_minute_in_all_charts(opened: Any, tmp_path: Path) -> None:
    """Charts of beliefs, which a check names, were empty in a browser that came back after ten seconds."""
    arguments = ("dead-reckoning", "--publish", "--speed", "1", "--duration", "300 s")
    with LiveRun(tmp_path, *arguments).until_running() as run, served(str(run.directory)) as address:
        first = tab(opened, address)
        began = first.time_s()
        wait_for(lambda: first.time_s() > began + 3.0, SOON_S, "a later time")
        first.page.context.close()
        later = tab(opened, address)
        wait_for(lambda: len(later.page.evaluate(BEGINNINGS)) == 13, SOON_S, "three signals of four vehicles")
        formation, *beliefs = later.page.evaluate(BEGINNINGS)
        assert formation < began + 1.0 and max(beliefs) < formation + 1.0
        assert later.wrong == []


def test_a_line_through_the_fleet_parts_it_and_ctrl_c_ends_run_and_page(opened: Any, tmp_path: Path) -> None:
    with LiveRun(tmp_path, *LONG, "--view", "--wait-for-subscribers") as run:  # the page is one
        address = wait_for(lambda: address_in(run.printed), SOON_S, "the address")
        page = tab(opened, address)
        page.page.locator(".fleet-checks").get_by_text("deaths").wait_for()  # the console answers: it can be asked
        page.page.get_by_role("button", name="Pause").click()
        page.page.get_by_role("button", name="Resume").wait_for()
        places = page.vehicles()
        across = sorted(x for x, _ in places.values())
        _, x = max((right - left, (left + right) / 2) for left, right in pairwise(across))
        page.page.get_by_role("button", name="Cut with a line").click()
        _, y = places[1]
        page.page.mouse.move(x, y - 30)
        page.page.mouse.down()
        page.page.mouse.move(x, y + 30, steps=3)
        page.page.mouse.up()
        typed = page.page.get_by_label("Fault, in the words of fleet inject").input_value()
        parts = {frozenset(map(int, part.split(","))) for part in typed.removeprefix("partition ").split(" / ")}
        left = frozenset(i for i, place in places.items() if place[0] < x)
        assert parts == {left, frozenset(places) - left}
        page.page.get_by_role("button", name="Inject").click()
        page.page.locator(".fleet-faults").get_by_text(typed).wait_for()
        assert page.wrong == []
        assert any("fleet.addons.page.page_process" in " ".join(process.cmdline()) for process in run.family())
        run.send(signal.SIGINT, group=True)
        assert run.status() == 130, run.printed
        run.until_nobody_is_left()
        assert "Traceback" not in run.printed


# Of the labels of vehicles: whether the canvas cuts one, and how many links they lie on.
LABELS = """() => {
    const { scene } = document.querySelector(".fleet-view").fleet;
    const wide = Math.max(...scene.boxes.map(([left, , wide]) => left + wide));
    return [Math.min(...scene.boxes.map(([left]) => left)) < 0 || wide > scene.width, scene.boxes.length];
}"""


@pytest.mark.parametrize("width", [390, 1400])
def test_charts_and_labels_are_not_cut(opened: Any, alone: Alone, width: int) -> None:
    """At 1400 px the fifth chart was cut, at 390 px the label of vehicle 1."""
    log = log_of(alone("partition-heal", "duration=2 s", "checks={signal: [{topic: state.z, below: 90 m}]}"))
    with served(str(log)) as address:
        one = tab(opened, address)
        one.page.set_viewport_size({"width": width, "height": 900})
        assert one.vehicles()
        assert one.page.evaluate(LABELS) == [False, 4]
        charts = one.page.locator(".fleet-charts")
        assert charts.locator(".fleet-chart").count() == 5
        assert charts.evaluate("(el) => el.scrollWidth <= el.clientWidth")
        assert one.wrong == []
