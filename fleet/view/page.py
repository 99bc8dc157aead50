"""The page: what every browser that is open gets, and what a click does. NiceGUI is used here and in `forms` only."""

from __future__ import annotations

import asyncio
import shlex
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from nicegui import app, run, ui
from nicegui.events import GenericEventArguments

from fleet.errors import FleetError
from fleet.execution.directory import in_use
from fleet.scene.styles import PAGE
from fleet.view import words
from fleet.view.chart_signals import commands_of
from fleet.view.feed import checks_asked, checks_judged
from fleet.view.forms import FaultForm
from fleet.view.live_feed import LiveFeed
from fleet.view.log_feed import LogFeed
from fleet.view.view_state import Row

PERIOD_S = 0.05  # between two pictures
LOOK_S = 1.0  # between two questions to the console
MOST_AHEAD = 40  # pictures on their way to a browser; further ones are left out,
TRY_AGAIN = 100  # but one of so many
SLOW_S = 3.0  # for which a page says that it is slower than the run
MOST_CHARTS = 8  # of signals, and columns, that a browser may ask for
MOST_COMMANDS = 100  # of the last ones, that are listed
ONLY_WATCHED = "this page may only watch"
_HERE = Path(__file__).parent


class FleetView(ui.element, component="page/fleet_view.js", esm={"fleet-view": "page/modules"}):
    """The adapter between NiceGUI and our modules, which know nothing of it."""

    def __init__(self, setup: Row, said: Callable[[Row], Any]) -> None:
        super().__init__()
        self.props["setup"] = setup
        self.on("say", lambda event: said(_said(event)))

    def give(self, changes: Row) -> None:
        """Change values of the model in the browser."""
        self.run_method("give", changes)


def _said(event: GenericEventArguments) -> Row:
    return event.args if isinstance(event.args, dict) else {}


class Page:
    """All browsers that look at one run or log."""

    def __init__(self, feed: LiveFeed | LogFeed, *, may_act: bool) -> None:
        self.feed = feed
        self.may_act = may_act and (not isinstance(feed, LiveFeed) or feed.may_act)
        self.commands: deque[str] = deque(maxlen=MOST_COMMANDS)  # that had the effect of what was done here
        self._viewers: list[Viewer] = []
        self._followed: set[str] = set()  # signals
        self.wholes = asyncio.Lock()  # curves of a log are looked up, and given, in the order of the questions
        self._busy = asyncio.Lock()  # one question at a time
        self.new = False

    def begin(self) -> None:
        """Let pictures come as soon as the server runs."""
        app.on_startup(self._show)
        if isinstance(self.feed, LiveFeed):
            app.on_startup(self.feed.listen)
            app.on_startup(self._look)
        app.on_shutdown(self.feed.close)

    def build(self) -> None:
        """Make the page of one browser."""
        ui.add_css(_HERE / "page" / "fleet_view.css")
        ui.query(".nicegui-content").classes("fleet-page")
        viewer = Viewer(self)
        ui.context.client.on_delete(lambda: self._forget(viewer))
        self._viewers.append(viewer)

    def _forget(self, viewer: Viewer) -> None:
        with suppress(ValueError):
            self._viewers.remove(viewer)
        self.follow()

    def follow(self) -> None:
        """Follow the signals that any browser shows. Raises KeyError: there is none of a name."""
        names = {name for viewer in self._viewers for some in viewer.signals.values() for name in some}
        if names != self._followed:
            self.feed.follow(names)
            self._followed = names

    def tell_all(self, changes: Row) -> None:
        """Give every browser something."""
        for viewer in self._viewers:
            viewer.give(changes)

    async def _show(self) -> None:
        """Give every browser each picture, for ever."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due = max(due + PERIOD_S, loop.time())
            await asyncio.sleep(due - loop.time())
            try:
                come = self.feed.advance()
            except FleetError as error:  # the log is not what it was, for instance
                self.tell_all({"problem": str(error)})
                return
            except Exception:  # a defect of ours, or a log that is none of ours: nobody should wait for more
                self.tell_all({"problem": "the picture stopped; fleet view says why"})
                raise
            if (come or self.new) and self._viewers:
                self.new = False
                frame = self.feed.picture.frame() | {"clock": self.feed.clock()}
                for viewer in self._viewers:
                    viewer.show(frame)

    async def _look(self) -> None:
        """Ask the console how it is doing, again and again, until the run is over."""
        assert isinstance(self.feed, LiveFeed)
        over, told = False, self.feed.checks
        while not over:
            async with self._busy:
                await run.io_bound(self.feed.look)
            over = bool(self.feed.clock()["over"])
            if self.feed.checks != told:
                told = self.feed.checks
                self.tell_all({"checks": told})
            self.new = True
            await asyncio.sleep(LOOK_S)
        # The result is written last, and a run that broke has none.
        while (verdicts := await run.io_bound(checks_judged, self.feed.log)) is None and in_use(self.feed.log.parent):
            await asyncio.sleep(LOOK_S)
        # One that was stopped has a result without verdicts; what stood last is none.
        self.feed.checks = verdicts if verdicts and verdicts["rows"] else checks_asked(self.feed.scenario)
        self.tell_all({"checks": self.feed.checks})

    async def do(self, command: str, op: str, **fields: Any) -> Row:
        """Ask the console for something, and note which command would have done it.

        Raises:
            FleetError: it refuses, or nothing may be asked for here.
        """
        if not self.may_act or not isinstance(self.feed, LiveFeed):
            raise FleetError(ONLY_WATCHED)
        feed = self.feed
        async with self._busy:
            answer = await run.io_bound(feed.ask, op, **fields)
        self.note(command)
        if not self.feed.clock()["over"]:
            async with self._busy:
                await run.io_bound(self.feed.look)
            self.new = True
        return answer or {}

    def note(self, command: str) -> None:
        """Add to the commands that had an effect."""
        self.commands.append(command)
        self.tell_all({"commands": list(self.commands)})


class Viewer:
    """One browser."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._ready = False
        self.signals: dict[str, list[str]] = {}  # that it shows, by where: names
        self._sent = self._seen = self._left_out = 0
        self._slow_until = 0.0  # [s of time.monotonic]: until then it says that pictures were left out
        self._told = -1  # which of the changes of faults and events it was told
        feed = page.feed
        setup = feed.picture.setup() | {
            "name": feed.name,
            "live": feed.live,
            "may_act": page.may_act and feed.live,
            "log_end_s": feed.end_s if isinstance(feed, LogFeed) else None,
            "log": shlex.quote(str(feed.path)) if isinstance(feed, LogFeed) else "",  # in commands to copy
            "charted": feed.charted,
            "theme": {
                "vehicles": PAGE.vehicles,
                "links": {state: stroke._asdict() for state, stroke in PAGE.links.items()},
                "colours": PAGE.colours,
            },
        }
        self.element = FleetView(setup, self._said)
        self._form = FaultForm(feed, page.do) if isinstance(feed, LiveFeed) and page.may_act else None

    def give(self, changes: Row) -> None:
        """Give it something, once it listens."""
        if self._ready:
            self.element.give(changes)

    def show(self, frame: Row) -> None:
        """Give it a picture, unless it is too far behind."""
        if not self._ready:
            return
        now = time.monotonic()
        if self._sent - self._seen > MOST_AHEAD:
            self._left_out += 1
            self._slow_until = now + SLOW_S
            if self._left_out % TRY_AGAIN:  # now and then one is sent: what was on its way may have been lost
                return
        self._sent += 1
        picture = self._page.feed.picture
        if self._told != picture.changes:
            self._told = picture.changes
            self.element.give({"known": picture.known()})
        self.element.give({"frame": frame | {"n": self._sent, "slow": now < self._slow_until}})

    async def _said(self, said: Row) -> None:
        """Take an action of a user in the browser."""
        try:
            await self._do(said)
        except FleetError as error:
            with self.element:
                ui.notify(str(error), type="negative", multi_line=True, timeout=8000)
        except (KeyError, TypeError, ValueError) as error:
            with self.element:
                ui.notify(f"not understood: {error}", type="negative")

    async def _do(self, said: Row) -> None:
        page, feed = self._page, self._page.feed
        match said.get("do"):
            case "ready":
                self._ready = True
                self._sent = self._seen = 0
                self._told = -1
                self.give({"history": feed.picture.history(), "checks": feed.checks,
                           "commands": list(page.commands), "signals": feed.signals.offered()})  # fmt: skip
                page.new = True
                await self._give_whole()
            case "seen":
                self._seen = int(said["n"])
            case "charts" | "columns" as where:  # signals, of one vehicle or of all
                names = [str(name) for name in said["names"]][:MOST_CHARTS]
                self._follow(where, [one for name in names for one in feed.signals.meant(name)])
                await self._give_whole()
            case "commands":  # of a vehicle that was chosen, where the run logs them; none: 0
                self._follow("vehicle", [name for name in commands_of(int(said["i"])) if name in feed.signals.by_name])
            case "link" | "vehicle" | "fleet" | "partition" as kind:
                if self._form is not None:
                    self._form.open(kind, said)
            case "heal":
                name = said.get("id")
                answer = await page.do(words.heal(name, feed.name), "heal", id=name)
                self._tell(f"healed {', '.join(answer['healed']) or 'nothing'} at t = {answer['at_s']:.2f} s")
            case "clock":
                do, value = str(said["how"]), said.get("value")
                await page.do(words.clock(do, value, feed.name), "clock", do=do, value=value)
            case "script":
                await self._download()
            case _ if isinstance(feed, LogFeed):
                self._play(feed, said)

    async def _give_whole(self) -> None:
        """The curves of a log, as far as they are shown; those of the newest question come last."""
        feed = self._page.feed
        if isinstance(feed, LogFeed):
            async with self._page.wholes:
                self.give({"whole": await run.io_bound(feed.whole, self.signals.get("charts", []))})

    def _follow(self, where: str, names: list[str]) -> None:
        before, self.signals = self.signals, self.signals | {where: names}
        try:
            self._page.follow()
        except KeyError:
            self.signals = before
            raise
        self.give({"history": self._page.feed.picture.history()})

    def _play(self, feed: LogFeed, said: Row) -> None:
        """Take an action on the time line of a log."""
        at_s: float | None = None
        match said.get("do"):
            case "toggle":
                feed.toggle()
            case "rate":
                feed.set_rate(float(said["rate"]))
            case "seek":
                at_s = float(said["at_s"])
            case "next fault":
                at_s = feed.next_fault()
                if at_s is None:
                    self._tell("no fault begins or ends after this")
            case "next loss":
                at_s = feed.next_loss()
                if at_s is None:
                    self._tell("no packet is lost after this")
        if at_s is not None:
            feed.seek(at_s)
            self._page.tell_all({"history": feed.picture.history()})
        self._page.new = True

    async def _download(self) -> None:
        """The run so far as a scenario."""
        from fleet.repeat.recorded_run import script

        page, feed = self._page, self._page.feed
        if not page.may_act or not isinstance(feed, LiveFeed):
            raise FleetError(ONLY_WATCHED)
        made = await run.io_bound(script, feed.log)
        with self.element:
            ui.download.content(made.to_yaml() if made else "", f"{feed.scenario.name}-again.yaml")
        page.note(f"fleet export {shlex.quote(str(feed.log))} --scenario > again.yaml")

    def _tell(self, text: str) -> None:
        with self.element:
            ui.notify(text)
