"""A live run for Foxglove's viewers: what they subscribe to is fetched from the run's publisher, and nothing else."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from fleet.addons.page.foxglove_server import FELL_BEHIND, FoxgloveChannel, FoxgloveServer, ServiceOffer, Subscription
from fleet.addons.page.source import LiveSource
from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, ask
from fleet.replay.capture import PublisherGone
from fleet.replay.live_journal import LiveJournal, left_out
from fleet.replay.topics import ask_topics
from fleet.scenario.text.fault_words import read_fault
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine

_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_DO = {"type": "string", "enum": ["pause", "resume", "step", "speed"]}


def services(run: LiveRun) -> list[ServiceOffer]:
    """The services; each asks the console of the run, and an error of its is the answer."""

    def inject(asked: dict[str, Any]) -> dict[str, Any]:
        what = asked.get("what")
        if not isinstance(what, str) or not what.strip():
            raise FleetError("what? The words of fleet inject, such as \"down '1<->2' for 5s\"")
        fault = read_fault(what)
        for key in ("for", "id"):
            if asked.get(key) not in (None, ""):
                fault[key] = asked[key]
        return ask(run, "inject", fault=fault)

    def clock(asked: dict[str, Any]) -> dict[str, Any]:
        do, value = asked.get("do"), asked.get("value")
        return ask(run, "clock", do=do, value=1 if do == "step" and value is None else value)

    return [
        ServiceOffer("/fleet/inject", _object(what=_TEXT, **{"for": _TEXT}, id=_TEXT),
                     _object(id=_TEXT, what=_TEXT, from_s=_NUMBER, to_s=_NUMBER), inject),
        ServiceOffer("/fleet/heal", _object(id=_TEXT), _object(healed=_list(_TEXT), at_s=_NUMBER),
                     lambda asked: ask(run, "heal", id=asked.get("id") or None)),
        ServiceOffer("/fleet/faults", _object(),
                     _object(faults=_list(_object(id=_TEXT, what=_TEXT, state=_TEXT))),
                     lambda _: ask(run, "faults")),
        ServiceOffer("/fleet/clock", _object(do=_DO, value=_NUMBER),
                     _object(clock=_TEXT, at_s=_NUMBER), clock),
    ]  # fmt: skip


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


POLL_S = 0.02
TELL_S = 2.0  # between two words on what is missing
COME_S = 1.0  # after the run, for what is still on its way to us,
REST_S = 5.0  # and then for what is on its way to viewers
OVER = "the run is over"
CLOCK = "transforms"  # the topic by which we know the time


class LiveBridge:
    """From the publisher of a live run to a server for viewers."""

    def __init__(self, source: LiveSource, journal: LiveJournal, host: str, port: int | None, *, control: bool) -> None:
        """Ask for the topics, and listen. `control`: whether viewers may inject, heal and hold the clock. Raises
        FleetError: the run does not say what it publishes; there is no port, or only the observer's credentials are at
        hand, and viewers are to control."""
        offered = services(source.open_control()) if control else ()
        self._journal = journal
        self._topics = dict(sorted(ask_topics(journal.bus, journal.keys).items()))
        self._numbers = {topic: n for n, topic in enumerate(self._topics)}
        self.server = FoxgloveServer(
            source.directory.name,
            host,
            port,
            {
                n: FoxgloveChannel(topic, "protobuf", known.schema, "protobuf", known.descriptor_set)
                for n, (topic, known) in enumerate(self._topics.items())
            },
            services=offered,
        )
        self._names = list(self._topics)
        self._ends: dict[int, Callable[[], None]] = {}
        self._latest_ns = 0
        self.missing = journal.missing
        self._told, self._told_s = 0, 0.0  # how many messages viewers were told are missing, and when

    def run(self, line: StatusLine) -> None:
        """Go on until the run is over."""
        over = PublisherGone(lambda: self._journal.bus.connected)
        if CLOCK in self._numbers:
            self._fetch(self._numbers[CLOCK])
        while not over():
            self._pass_on(line)
            self._tell(line)
        self._take()
        deadline = time.monotonic() + COME_S
        while time.monotonic() < deadline and self.missing.to_come:
            self._pass_on(line)
        self._tell(line, last=True)
        self.server.say(OVER)
        deadline = time.monotonic() + REST_S
        while time.monotonic() < deadline and self.server.viewers:  # their messages may wait in the server
            self._pass_on(line)

    def _pass_on(self, line: StatusLine) -> None:
        for event in self.server.events(POLL_S):
            if isinstance(event, Subscription):
                self._follow(event.channel)
        self._take()
        self.server.time(self._latest_ns)
        if self.server.fell_behind():
            line.print(FELL_BEHIND)
        line.update(self._describe)

    def _take(self) -> None:
        for message in self._journal.take():
            self._latest_ns = max(self._latest_ns, message.log_ns)
            self.server.put(self._numbers[message.topic], message.data, message.log_ns)

    def _tell(self, line: StatusLine, *, last: bool = False) -> None:
        now, count = time.monotonic(), self.missing.count if last else self.missing.lost
        if count > self._told and (last or now - self._told_s >= TELL_S):
            self._told, self._told_s = count, now
            text = left_out(count)
            self.server.say(text, warning=True)
            line.print(text)

    def _follow(self, number: int) -> None:
        if number in self.server.wanted:
            if number not in self._ends:
                self._fetch(number)
        elif number in self._ends and self._names[number] != CLOCK:
            self._ends.pop(number)()

    def _fetch(self, number: int) -> None:
        topic = self._names[number]
        self._take()  # or messages of a subscription before would count as those of this one
        self.missing.forget(topic)
        self._ends[number] = self._journal.subscribe(topic)

    def _describe(self) -> list[Piece]:
        viewers = self.server.viewers
        return [
            Piece(0, [f"t = {self._latest_ns / 1e9:.2f} s"]),
            Piece(1, [f"{viewers} viewer{'' if viewers == 1 else 's'}"]),
            Piece(2, [f"{len(self.server.wanted)} of {len(self._topics)} topics", ""]),
            Piece(3, [f"{self.server.sent} messages", ""]),
            Piece(2, [f"{self.missing.lost} missing" if self.missing.lost else "", ""]),
        ]
