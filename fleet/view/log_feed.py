"""A log as a page shows it: played, paused, at any time, at any rate."""

from __future__ import annotations

import time
from collections.abc import Collection
from functools import cached_property
from pathlib import Path
from typing import Any

from fleet.logs.fault_intervals import MOST_EVENTS
from fleet.logs.reader import LogReadError
from fleet.logs.tape import Tape, Track
from fleet.logs.topic_names import believer_of, link_of, run_name
from fleet.quantities import vehicle_numbers
from fleet.repeat.recorded_run import recorded
from fleet.replay.player import Player
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import checked_signals
from fleet.scenario.sections.vehicle_events import DIVERGED, TUMBLED
from fleet.view import overview
from fleet.view.chart_signals import Signals
from fleet.view.feed import FAULTS, MOST_CHARTED, TRANSFORMS, checks_asked, checks_judged, fault_message, is_lost, take
from fleet.view.view_state import HISTORY_S, NOT_PLACED, Row, ViewState

MOST_FAULT_BYTES = 32 << 20  # of all messages about faults
MOST_AT_ONCE = 20_000  # messages between two pictures, and those that a jump looks back on


class LogFeed:
    """Plays one log."""

    live = False

    def __init__(self, path: Path, rate: float = 1.0, *, loop: bool = False) -> None:
        """Read it through.

        Args:
            rate: of the playback, times its own pace.
            loop: begin again at the end.

        Raises:
            LogReadError: it cannot be read.
            FleetError: it holds no scenario of ours.
        """
        self.path = path
        self._loop = loop
        self.name = run_name(path)
        run = recorded(path)
        self.scenario: Scenario = run.script()
        self._tape = Tape(run.path)
        self._topics = {n: channel.topic for n, channel in self._tape.channels.items()}
        self.signals = Signals(self._tape.channels.values(), self._tape.schemas)
        self.picture = ViewState(self.scenario)
        self.picture.faults(self._all_faults())
        self.missing = self._tape.missing
        judged = checks_judged(path)
        self.checks = judged if judged and judged["rows"] else checks_asked(self.scenario)
        looked_at = [name for row in self.checks["rows"] for name in row.get("signals", ())]
        checked = map(str, checked_signals(self.scenario.spec.checks, looked_at))
        self.charted = [name for name in checked if self.signals.of_all(name)][:MOST_CHARTED]
        self._track = self._tracked()
        self._beliefs = [(len(numbers), Track(self._tape, numbers)) for numbers in self._believers()]
        self.end_s = self._tape.end_ns / 1e9
        self.player = self._player(0, rate)
        self._jumped = False
        self.seek(0.0)

    def _believers(self) -> list[list[int]]:
        """The channels of what vehicles believe: by navigator, and by ranges, which may come at another rate."""
        found: dict[str, list[int]] = {}
        for number, topic in self._topics.items():
            if believer := believer_of(topic):
                found.setdefault(believer[1], []).append(number)
        return list(found.values())

    def _tracked(self) -> Track:
        more = self.signals.followed
        chosen = [n for n, t in self._topics.items() if t == TRANSFORMS or link_of(t) is not None or t in more]
        return Track(self._tape, chosen)

    def _player(self, at_ns: int, rate: float = 1.0, *, paused: bool = True) -> Player:
        now = time.monotonic_ns()
        track = self._track
        player = Player(track, 0, self._tape.end_ns, rate=rate, paused=paused, now=now, before=track.before)
        player.seek(now, at_ns)
        return player

    def _all_faults(self) -> list[Row]:
        """Every fault that the log tells of, with its end.

        Raises:
            LogReadError: they are more than anybody could look at.
        """
        found: dict[str, Row] = {}
        held = 0  # bytes
        end_s = self._tape.end_ns / 1e9
        track = Track(self._tape, [n for n, topic in self._topics.items() if topic == FAULTS])
        for _, entry in track.entries(range(len(track))):
            held += len(entry.data)
            if len(track) > MOST_EVENTS or held > MOST_FAULT_BYTES:
                most = f"{MOST_EVENTS} messages or {MOST_FAULT_BYTES} bytes"
                raise LogReadError(f"{self.path} tells of more faults than are shown: expected at most {most}")
            event, at_s = fault_message(entry.data), entry.log_ns / 1e9
            if event is None:  # damaged
                continue
            if event.action == "begins":
                times = {"from_s": at_s, "to_s": end_s, "until_healed": False}
                found[event.fault] = {"id": event.fault, "what": event.what} | times
            elif event.fault in found:
                found[event.fault]["to_s"] = at_s
        return list(found.values())

    def advance(self) -> bool:
        """Take what is due; whether there is something new to show."""
        now = time.monotonic_ns()
        some = self.player.due(now, MOST_AT_ONCE)
        self._take(some, moving=True)
        if not self.picture.placed:  # else time is that of the places
            self.picture.at_s = min(self.player.position(now) / 1e9, self.end_s)
        self._take_beliefs()
        new = bool(some) or self._jumped or not self.picture.placed
        self._jumped = False
        if self.player.over and not self.player.paused:
            self.player.pause(now)
            new = True
            if self._loop:
                self.toggle()
        return new

    def _take(self, some: range, *, moving: bool) -> None:
        for _, entry in self._track.entries(some):
            topic = entry.channel.topic
            take(self.picture, topic, entry.log_ns / 1e9, entry.data, moving=moving)
            for name, value in self.signals.values(topic, entry.data):
                self.picture.signal(name, entry.log_ns / 1e9, value)

    def _take_beliefs(self) -> None:
        """Take the newest of each vehicle: they are many, and a picture shows one."""
        for vehicles, track in self._beliefs:
            stop = track.before(int(self.picture.at_s * 1e9) + 1)
            for _, entry in track.entries(range(max(0, stop - vehicles), stop)):
                take(self.picture, entry.channel.topic, entry.log_ns / 1e9, entry.data)

    def clock(self) -> Row:
        """How time goes."""
        player = self.player
        over = player.over
        text = "at the end" if over else "paused" if player.paused else f"{player.rate:g} x real time"
        note = f"The log is not whole: {self.missing}" if self.missing else ""
        note = note or ("" if self.picture.placed else NOT_PLACED)
        return {"text": text, "paused": player.paused, "rate": player.rate, "over": over, "waiting": "", "note": note}

    # What the time line does

    def toggle(self) -> None:
        """Play or pause; from the end it begins again."""
        if self.player.over:
            self.seek(0.0)
        self.player.toggle(time.monotonic_ns())

    def set_rate(self, rate: float) -> None:
        """Go on at another rate."""
        self.player.set_rate(time.monotonic_ns(), rate)

    def seek(self, at_s: float) -> None:
        """Go to a time; what charts show is looked up from the minute before it."""
        at_s = min(max(at_s, 0.0), self.end_s)
        track, at_ns = self._track, int(at_s * 1e9)
        stop = track.before(at_ns + 1)
        first = max(track.before(int(max(0.0, at_s - HISTORY_S) * 1e9)), stop - MOST_AT_ONCE)
        self.picture.clear(0.0 if not first else track[first] / 1e9)
        self._take(range(first, stop), moving=False)
        self.picture.at_s = at_s
        self._take_beliefs()
        self.player.seek(time.monotonic_ns(), at_ns)
        self._jumped = True

    def first_failure_s(self) -> float:
        """When the first of the failed checks failed, as far as that is known; 0: none did.

        Each of these checks knows then when it failed, as `at_s`.

        Raises:
            LogReadError: the log cannot be read.
        """
        failed = [row for row in self.checks["rows"] if row["passed"] is False]
        for row in failed:
            row["at_s"] = self._failed_s(row)
        known = [row["at_s"] for row in failed if row["at_s"] is not None and 0.0 <= row["at_s"] <= self.end_s]
        return min(known, default=self.end_s if failed else 0.0)

    def _failed_s(self, row: Row) -> float | None:
        if row.get("at_s") is not None:
            return float(row["at_s"])
        section = self.scenario.spec.checks
        if row["check"] == TUMBLED:
            times = [one.first_s for one in self.picture.vehicle_events if one.what.startswith((TUMBLED, DIVERGED))]
            return min(times, default=None)
        if row["check"] == "formation_error" and (asked := section.formation_error) is not None:
            who = None if asked.vehicles is None else vehicle_numbers(asked.vehicles)
            vehicles = range(1, self.scenario.vehicles + 1) if who is None else who
            return overview.first_above(self.path, vehicles, asked.below, asked.after / 1e9)
        return None

    def whole(self, names: Collection[str] = ()) -> Row:
        """The data of charts over the whole log: samples, and the values of signals.

        Raises:
            LogReadError: the log cannot be read.
        """
        return {
            "samples": self._samples,
            "signals": overview.curves(self.path, [self.signals.by_name[name] for name in sorted(names)]),
        }

    @cached_property
    def _samples(self) -> list[list[Any]]:
        return overview.samples(self.path, self.end_s, self.scenario.vehicles, self.picture.neighbours)

    def forward(self, at_s: float) -> None:
        """Take everything up to a later time, as if it had been played until then."""
        before = self._track.before
        self._take(range(before(int(self.picture.at_s * 1e9) + 1), before(int(at_s * 1e9) + 1)), moving=True)
        self.picture.at_s = at_s
        self._take_beliefs()

    def next_fault(self) -> float | None:
        """When the next fault begins or ends [s]; None: none does."""
        t = self.picture.at_s + 1e-6
        times = [at for row in self.picture.known_faults for at in (row["from_s"], row["to_s"])]
        return min((at for at in times if t < at < self.end_s), default=None)

    def next_loss(self) -> float | None:
        """When the next packet is lost [s]; None: none is."""
        track = self._track
        for _, entry in track.entries(range(track.before(int(self.picture.at_s * 1e9) + 1), len(track))):
            if link_of(entry.channel.topic) is None:
                continue
            if is_lost(entry.data):
                return entry.log_ns / 1e9
        return None

    def follow(self, names: Collection[str]) -> None:
        """Bring these signals and no others into the picture. Raises KeyError: there is none of a name."""
        self.signals.follow(names)
        self.picture.follow(names)
        at_s, player = self.picture.at_s, self.player
        self._track = self._tracked()
        self.player = self._player(int(at_s * 1e9), player.rate, paused=player.paused)
        self.seek(at_s)

    def close(self) -> None:
        """End."""
