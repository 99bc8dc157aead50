"""The page: what every browser that is open gets, and what a click does. NiceGUI is used here and in `forms` only."""

from __future__ import annotations

import asyncio
import shlex
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from nicegui import app, run, ui
from nicegui.events import GenericEventArguments

from fleet.addons.page.chart_signals import commands_of
from fleet.addons.page.feed import checks_asked, checks_judged
from fleet.addons.page.live_feed import LiveFeed
from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.view_state import Row
from fleet.errors import FleetError
from fleet.execution.directory import is_in_use
from fleet.execution.fault_request import check_fault
from fleet.recorder.scene.styles import PAGE
from fleet.scenario.faults.kind import FaultKind, LinkFaultKind, VehicleFaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.fault_words import read_fault


def suggestions(about: type[FaultKind], target: str = "") -> dict[str, str]:
    """Faults as words, by what to call them: of a link (`1->2`, `1<->2`) or a vehicle, or of what has no target."""
    offered = [offer for kind in KINDS.values() if isinstance(kind, about) for offer in kind.offers]
    return {name: words.format(target) for name, words in offered if ("{0}" in words) is bool(target)}


def entry(words: str, lasts: str, scenario: Scenario, tick: int) -> dict[str, Any]:
    """The fault that words describe, checked by the rules of scenarios as if it began at a tick. `lasts`: how long, as
    `10s`; empty: until healed. Raises FleetError: it is none, or not for this scenario; the text says what is wrong."""
    found = read_fault(words)
    if lasts.strip():
        if "for" in found:
            raise FleetError(f"the fault says for {found['for']} already")
        found["for"] = lasts.strip()
    check_fault(found, tick, scenario)
    return found


def inject(words: str, lasts: str, run: str) -> str:
    """The command that injects a fault."""
    more = ["--for", lasts.strip()] if lasts.strip() else []
    options, fault = [*more, "--run", run], words.split()
    if any(word.startswith("-") for word in fault):  # a number below zero is no option
        return shlex.join(["fleet", "inject", *options, "--", *fault])
    return shlex.join(["fleet", "inject", *fault, *options])


def heal(name: str | None, run: str) -> str:
    return shlex.join(["fleet", "heal", *([name] if name else []), "--run", run])


def clock(do: str, value: float | None, run: str) -> str:
    number = "max" if do == "speed" and value is None else "" if value is None else f"{value:g}"
    return shlex.join(["fleet", "clock", do, *([number] if number else []), "--run", run])


def partition(groups: list[list[int]]) -> str:
    """The words that cut the fleet into groups."""
    return f"partition {' / '.join(','.join(map(str, group)) for group in groups)}"


Do = Callable[..., Awaitable[Row]]  # a command, the operation and its fields: what the console answers


class FaultForm:
    """A dialog for one fault, of a link, a vehicle or the fleet."""

    def __init__(self, feed: LiveFeed, do: Do) -> None:
        self._feed, self._do = feed, do
        self._entry: dict[str, Any] | None = None
        with (
            ui.dialog().props('aria-label="A fault"').classes("fleet-dialog") as self._dialog,
            ui.card().classes("fleet-form"),
        ):
            self._title = ui.label().classes("fleet-form-title")
            self._choices = ui.row().classes("fleet-form-choices")
            self._words = ui.input("Fault, in the words of fleet inject", on_change=self._check).props("autofocus")
            self._lasts = ui.input("For how long", placeholder="until healed", on_change=self._check)
            self._problem = ui.label().classes("fleet-form-problem").props("role=alert")
            with ui.row().classes("fleet-form-command"):
                self._command = ui.label()
                ui.button(icon="content_copy", on_click=lambda: ui.clipboard.write(self._command.text)).props(
                    'flat dense aria-label="Copy the command"'
                )
            with ui.row().classes("fleet-form-buttons"):
                ui.button("Cancel", on_click=self._dialog.close).props("flat")
                self._inject = ui.button("Inject", on_click=self._go).classes("fleet-main-button")
            self._dialog.on("show", lambda: self._words.run_method("select"))  # what is typed takes its place
            self._words.on("keydown.enter", self._go)
            self._lasts.on("keydown.enter", self._go)

    def open(self, kind: str, said: Row) -> None:
        offered: dict[str, str] = {}
        match kind:
            case "link":
                src, dst = int(said["src"]), int(said["dst"])
                offered = suggestions(LinkFaultKind, f"{src}->{dst}")
                both = (dst, src) in self._feed.scenario.graph.links
                if both:
                    offered["cut both ways"] = f"down {src}<->{dst}"
                title = f"Link from vehicle {src} to vehicle {dst}"
            case "vehicle":
                offered = suggestions(VehicleFaultKind, str(int(said["i"])))
                title = f"Vehicle {int(said['i'])}"
            case "partition":
                groups = [[int(i) for i in group] for group in said["groups"]]
                offered = {"partition": partition(groups)}
                title = "Cut the network in two"
            case _:
                offered = suggestions(FaultKind)
                title = "Disturb the fleet"
        self._title.text = title
        self._choices.clear()
        with self._choices:
            for name, text in offered.items():
                ui.button(name, on_click=lambda _, text=text: self._words.set_value(text)).props(
                    "outline dense no-caps"
                )
        self._lasts.value = ""
        self._words.value = next(iter(offered.values()))
        self._check()
        self._dialog.props(f"position={_away(said.get('at'))}")
        self._dialog.open()

    def _check(self) -> None:
        feed = self._feed
        text, lasts = self._words.value or "", self._lasts.value or ""
        tick = min(int(feed.picture.at_s * 1e9) // feed.scenario.tick_ns, feed.scenario.ticks - 1)
        try:
            self._entry = entry(text, lasts, feed.scenario, tick)
            problem = ""
        except FleetError as error:
            self._entry, problem = None, str(error)
        self._problem.text = problem
        self._inject.set_enabled(self._entry is not None)
        self._command.text = inject(text, lasts, feed.name)

    async def _go(self) -> None:
        entry, self._entry = self._entry, None  # once, however often the key is pressed
        if entry is None:
            return
        try:
            answer = await self._do(self._command.text, "inject", fault=entry)
        except FleetError as error:
            self._entry = entry
            self._problem.text = str(error)
            return
        self._dialog.close()
        ui.notify(
            f"{answer['id']}: {answer['what']}, from t = {answer['from_s']:.2f} s", type="positive", position="top"
        )


def _away(at: Any) -> str:
    """At which side of the window a dialog hides least of what was clicked. `at`: where that was, as shares of the
    window from the left and from the top, and whether the window is narrow."""
    match at:
        case [float() | int() as x, float() | int() as y, narrow]:
            return ("top" if y > 0.5 else "bottom") if narrow else ("left" if x > 0.5 else "right")
    return "standard"


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
        for viewer in self._viewers:
            viewer.give(changes)

    async def _show(self) -> None:
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
        while (verdicts := await run.io_bound(checks_judged, self.feed.log)) is None and is_in_use(
            self.feed.log.parent
        ):
            await asyncio.sleep(LOOK_S)
        # One that was stopped has a result without verdicts; what stood last is none.
        self.feed.checks = verdicts if verdicts and verdicts["rows"] else checks_asked(self.feed.scenario)
        self.tell_all({"checks": self.feed.checks})

    async def do(self, command: str, op: str, **fields: Any) -> Row:
        """Ask the console for something, and note which command would have done it. Raises FleetError: it refuses, or
        nothing may be asked for here."""
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
        self.commands.append(command)
        self.tell_all({"commands": list(self.commands)})


class Viewer:
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
        try:
            await self._do(said)
        except FleetError as error:
            with self.element:
                ui.notify(str(error), type="negative", multi_line=True, timeout=8000, position="top")
        except (KeyError, TypeError, ValueError) as error:
            with self.element:
                ui.notify(f"not understood: {error}", type="negative", position="top")

    async def _do(self, said: Row) -> None:
        page, feed = self._page, self._page.feed
        match said.get("do"):
            case "ready":
                self._ready = True
                self._sent = self._seen = 0
                self._told = -1
                self.give({"history": feed.picture.history(), "checks": feed.checks,
                           "commands": list(page.commands), "signals": feed.signals.offers()})  # fmt: skip
                page.new = True
                await self._give_whole()
            case "seen":
                self._seen = int(said["n"])
            case "charts" | "columns" as where:  # signals, of one vehicle or of all
                names = [str(name) for name in said["names"]][:MOST_CHARTS]
                self._follow(where, [one for name in names for one in feed.signals.names_of(name)])
                await self._give_whole()
            case "commands":  # of a vehicle that was chosen, where the run logs them; none: 0
                self._follow("vehicle", [name for name in commands_of(int(said["i"])) if name in feed.signals.by_name])
            case "link" | "vehicle" | "fleet" | "partition" as kind:
                if self._form is not None:
                    self._form.open(kind, said)
            case "heal":
                name = said.get("id")
                answer = await page.do(heal(name, feed.name), "heal", id=name)
                self._tell(f"healed {', '.join(answer['healed']) or 'nothing'} at t = {answer['at_s']:.2f} s")
            case "clock":
                do, value = str(said["how"]), said.get("value")
                await page.do(clock(do, value, feed.name), "clock", do=do, value=value)
            case "script":
                await self._download()
            case _ if isinstance(feed, LogFeed):
                self._play(feed, said)

    async def _give_whole(self) -> None:
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
            ui.notify(text, position="top")
