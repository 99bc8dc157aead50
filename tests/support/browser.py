"""A real browser without a screen, and the page of `fleet view` in it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from math import dist
from typing import Any

import pytest
from live import Command
from waiting import wait_for

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SOON_S = 60.0  # for a machine that does other things at the same time
SIZE = {"width": 1280, "height": 800}
_ADDRESS = re.compile(r"http://\S+\?token=\S+")


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """`fleet view ...` in a process of its own; yields the address that it prints."""
    with Command("view", *arguments, "--no-open") as viewer:
        yield address_in(viewer.until("?token=").printed)


def address_in(printed: str) -> str:
    """The address of a page, of what a command printed; empty: it printed none yet."""
    found = _ADDRESS.search(printed)
    return found.group() if found else ""


class Tab:
    """A page in the browser, with everything that went wrong in it."""

    def __init__(self, page: Any, address: str, start: str) -> None:
        self.page = page
        self.wrong: list[str] = []
        origin = address.partition("/?")[0]
        page.on("console", lambda message: message.type == "error" and self.wrong.append(message.text))
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", lambda asked: asked.url != start and self._asked(asked.url, origin))
        page.goto(start)
        page.locator(".fleet-side tbody td:nth-child(2):text-matches('\\\\d')").first.wait_for()

    def _asked(self, url: str, origin: str) -> None:
        if not url.startswith((origin, origin.replace("http", "ws"), "data:", "blob:")):
            self.wrong.append(f"asked for {url}")

    def time_s(self) -> float:
        """The time that it shows."""
        return float(re.findall(r"[\d.]+", self.page.locator(".fleet-time").inner_text())[0])

    def link(self, src: int, dst: int) -> tuple[float, float]:
        """Where on the page a link is drawn, nearer to its receiver, once the view has come to rest."""
        where = f"""() => {{
            const scene = document.querySelector(".fleet-view").fleet.scene;
            scene.dirty = true;
            const k = scene.setup.links.findIndex(([a, b]) => a === {src} && b === {dst});
            const [p, q] = scene.lanes[k];
            const box = scene.canvas.getBoundingClientRect();
            return [box.x + p[0] + 0.6 * (q[0] - p[0]), box.y + p[1] + 0.6 * (q[1] - p[1])];
        }}"""
        x, y = self._at_rest(where)
        return x, y

    def vehicles(self) -> dict[int, tuple[float, float]]:
        """Where on the page the vehicles are drawn, once the view has come to rest."""
        where = """() => {
            const scene = document.querySelector(".fleet-view").fleet.scene;
            scene.dirty = true;
            const box = scene.canvas.getBoundingClientRect();
            return scene.spots.toSorted((a, b) => a.i - b.i).flatMap(({ i, x, y }) => [box.x + x, box.y + y]);
        }"""
        found = self._at_rest(where)
        return {k + 1: (found[2 * k], found[2 * k + 1]) for k in range(len(found) // 2)}

    def _at_rest(self, where: str) -> list[float]:
        """The coordinates that a function of the page gives, once they stay as they are."""
        places: list[list[float]] = []

        def rests() -> bool:
            places.append(self.page.evaluate(where))
            return len(places) > 5 and len(places[-1]) > 0 and dist(places[-6], places[-1]) < 1.0

        wait_for(rests, SOON_S, "a view at rest")
        return places[-1]


@contextmanager
def browser() -> Iterator[Any]:
    """A browser; skips the test where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install '.[test-all]'")
    path = next((found for found in map(shutil.which, BROWSERS) if found), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is on the PATH")
    with api.sync_playwright() as playwright:
        # A browser of root has no sandbox; it loads our own page and nothing else.
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield opened
        finally:
            opened.close()


def tab(opened: Any, address: str, start: str = "") -> Tab:
    """A page of its own, with no cookie of another's.

    Args:
        start: what leads to the address, if it is not opened itself.
    """
    page = opened.new_context(viewport=SIZE).new_page()
    page.set_default_timeout(1000 * SOON_S)
    return Tab(page, address, start or address)
