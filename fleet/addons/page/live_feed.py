"""A live run as a page shows it: its journal from the publisher, its clock and faults from its console.

Messages wait in the journal until the next picture.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any

from fleet.addons.page.chart_signals import published_signals
from fleet.addons.page.feed import FAULTS, MOST_CHARTED, TRANSFORMS, checks_asked, checks_so_far, take
from fleet.addons.page.source import LiveSource
from fleet.addons.page.view_state import NOT_PLACED, SAMPLE_S, Row, ViewState, fault_row
from fleet.execution.connection import OpenConnection, RemoteError, find, is_live
from fleet.execution.directory import SCENARIO, is_in_use
from fleet.logs.topic_names import BELIEFS, link_of
from fleet.replay.live_journal import LiveJournal, Missing, left_out
from fleet.replay.player import MeasuredRate
from fleet.replay.topics import ask_scenario, ask_topics
from fleet.result.file import RESULT
from fleet.scenario.loading import parse_scenario
from fleet.scenario.sections.signal_checks import checked_signals
from fleet.scenario.sections.timeline import FaultInterval


class LiveFeed:
    live = True

    def __init__(self, source: LiveSource) -> None:
        """Connect, and subscribe unless the run is awaited: then `listen` does. Raises FleetError: the publisher cannot
        be reached, or does not say what it publishes; ScenarioError: that scenario is none for this version."""
        self.source = source
        self.name = source.directory.name
        self.log = source.directory / "run.mcap"
        self._status: Row = {}
        self._told: Row = {}  # the same, until the picture has it
        self._over = ""  # why there is nothing more to come
        self._published = True
        self._rate = MeasuredRate()
        self._ends: dict[str, Callable[[], None]] = {}  # of the subscriptions to topics of signals
        self._connection: OpenConnection | None = None
        self._journal = journal = LiveJournal.connect(source.observed, self.name)
        try:
            text = ask_scenario(journal.bus, journal.keys)
            self.scenario = parse_scenario(text, str(source.directory / SCENARIO))
            self.signals = published_signals(ask_topics(journal.bus, journal.keys))
        except BaseException:
            journal.close()
            raise
        self.picture = ViewState(self.scenario)
        self.checks = checks_asked(self.scenario)  # as they stand
        checked = map(str, checked_signals(self.scenario.spec.checks))
        self.charted = [name for name in checked if self.signals.of_all(name)][:MOST_CHARTED]
        self._run = source.run
        self._listening = False
        self._begun = source.awaited  # whether it is known from when on messages come
        if not source.awaited:
            self.listen()

    def listen(self) -> None:
        """Subscribe to what is drawn, once; a run that waits for a subscriber begins then."""
        if not self._listening:
            self._listening = True
            for topic in (TRANSFORMS, FAULTS, "link/*"):
                self._journal.subscribe(topic)
            if self.picture.scene.navigating:
                for topics in BELIEFS:
                    self._journal.subscribe_newest(topics)  # a picture shows one of each vehicle
            self.follow(())

    @property
    def missing(self) -> Missing:
        return self._journal.missing

    @property
    def may_act(self) -> bool:
        """Whether the run may be disturbed, now or as soon as its console answers."""
        return self._run is not None or self.source.awaited

    def advance(self) -> bool:
        """Take what has come; whether there is something new to show."""
        beliefs, come = self._journal.take_newest(), self._journal.take()
        placed: tuple[float, bytes] | None = None
        shown_s = self.picture.at_s
        told, self._told = self._told, {}
        if (come or told) and not self._begun:
            self._begun = True
            self.picture.clear(come[0].log_ns / 1e9 if come else told["at_s"])
        for topic, log_ns, data in come:
            at_s = log_ns / 1e9
            if topic == TRANSFORMS:
                # As fast as it goes, a run makes more of them than anybody can see.
                if placed is not None and placed[0] - shown_s >= SAMPLE_S:
                    take(self.picture, topic, *placed)
                    shown_s = placed[0]
                placed = at_s, data
            else:
                take(self.picture, topic, at_s, data, self.signals)
        if placed is not None:
            take(self.picture, TRANSFORMS, *placed)
        for topic, log_ns, data in beliefs:
            take(self.picture, topic, log_ns / 1e9, data)
        if told:
            self.picture.set_link_ages(told["at_s"], told["links"])
        self._rate.update(time.monotonic_ns(), int(self.picture.at_s * 1e9))
        return bool(come or beliefs)

    def look(self) -> None:
        """Ask the console how it is doing. Waits for the answer: on a thread of its own."""
        if self._over:
            return
        self._published = self._journal.bus.connected
        if self._run is None and self.source.awaited and is_in_use(self.source.directory):
            with suppress(RemoteError):
                self._run = find(str(self.source.directory))
            if self._run is None:
                return
        if self._run is None:
            if not self._published:
                self._over = "the publisher is gone"
            return
        try:
            self._status = self._told = self.ask("status", all=True)
            known = self.ask("faults")
            events = known["events"]
            lasting = [
                fault_row(FaultInterval(row["id"], row["last_s"], self._status["end_s"], row["what"], row["entry"]))
                for row in events
                if row["lasts"]
            ]
            self.picture.faults([*known["faults"], *lasting])
            self.picture.set_vehicle_events(events)
            self.checks = checks_so_far(self.ask("checks")["checks"])
        except RemoteError as error:
            if is_live(self._run):
                self._status = self._status | {"waiting": str(error)}
            else:
                whole = is_in_use(self.source.directory) or (self.source.directory / RESULT).exists()
                self._over = "the run is over" if whole else "the run broke: its console is gone"

    def ask(self, op: str, **fields: Any) -> Row:
        """Ask the console for something, over a connection that stays. Raises RemoteError: it refuses, or does not
        answer; or only an observer's credentials are at hand."""
        if self._run is None and self.source.awaited:
            raise RemoteError(f"the console of {self.name} does not answer yet")
        if self._run is None:
            raise RemoteError(f"{self.name} may only be watched with these credentials", 2)
        if self._over:
            raise RemoteError(f"{self._over}: nothing can be changed any more")
        self._connection = self._connection or OpenConnection(self._run)
        return self._connection.ask(op, **fields)

    def clock(self) -> Row:
        status, over = self._status, self._over
        text = over or status.get("clock", "waiting for the run")
        waiting = status.get("waiting", "")
        return {
            "text": text,
            "paused": text == "paused",
            "rate": 0.0 if over or text == "paused" else round(self._rate.value, 2),
            "over": bool(over),
            "waiting": "" if over or waiting == text else waiting,
            "note": self._note(),
        }

    def _note(self) -> str:
        count = self.missing.count if self._over else self.missing.lost
        lost = f"{left_out(count)}." if count else ""
        if self._over:
            return lost
        if not self._published:
            return "The publisher is gone: the run goes on, and nothing more of it is seen here."
        return lost if self.picture.placed else NOT_PLACED

    def follow(self, names: Collection[str]) -> None:
        """Bring these signals into the picture, and those that have a chart from the start, and no others. The latter
        need no browser that asks for them. So one that comes later, or comes back, sees their last minute. Raises
        KeyError: there is none of a name."""
        names = {*names, *(name for charted in self.charted for name in self.signals.names_of(charted))}
        self.signals.follow(names)
        self.picture.follow(names)
        topics = {topic for topic in self.signals.followed if link_of(topic) is None}  # those of links come already
        for topic in self._ends.keys() - topics:
            self._ends.pop(topic)()
        for topic in topics - self._ends.keys():
            self.missing.forget(topic)
            self._ends[topic] = self._journal.subscribe(topic)

    def close(self) -> None:
        self._journal.close()
        if self._connection is not None:
            self._connection.close()
