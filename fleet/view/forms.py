"""The form for a fault. It makes the fault's words, and checks them as the user types."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from fleet.errors import FleetError
from fleet.view import words
from fleet.view.live_feed import LiveFeed
from fleet.view.view_state import Row

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
        """Show it for what was clicked."""
        offered: dict[str, str] = {}
        match kind:
            case "link":
                src, dst = int(said["src"]), int(said["dst"])
                offered = words.suggestions("link", f"{src}->{dst}")
                both = (dst, src) in self._feed.scenario.graph.links
                if both:
                    offered["cut both ways"] = f"down {src}<->{dst}"
                title = f"Link from vehicle {src} to vehicle {dst}"
            case "vehicle":
                offered = words.suggestions("vehicle", str(int(said["i"])))
                title = f"Vehicle {int(said['i'])}"
            case "partition":
                groups = [[int(i) for i in group] for group in said["groups"]]
                offered = {"partition": words.partition(groups)}
                title = "Cut the network in two"
            case _:
                offered = words.suggestions("fleet", "")
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
            self._entry = words.entry(text, lasts, feed.scenario, tick)
            problem = ""
        except FleetError as error:
            self._entry, problem = None, str(error)
        self._problem.text = problem
        self._inject.set_enabled(self._entry is not None)
        self._command.text = words.inject(text, lasts, feed.name)

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
        ui.notify(f"{answer['id']}: {answer['what']}, from t = {answer['from_s']:.2f} s", type="positive")


def _away(at: Any) -> str:
    """At which side of the window a dialog hides least of what was clicked.

    Args:
        at: where that was, as shares of the window from the left and from the top, and whether the window is narrow.
    """
    match at:
        case [float() | int() as x, float() | int() as y, narrow]:
            return ("top" if y > 0.5 else "bottom") if narrow else ("left" if x > 0.5 else "right")
    return "standard"
