"""The journal: frames of the world and reports of netem, merged into one total order and written tick by tick.

Tick t is written only when world and netem are both complete to t, in the order (t, topic, src, dst, seq, copy).
The clock's grants stay within a window of what is written, so a slow disk slows the run and loses nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import count
from typing import NamedTuple, Protocol

from msgspec import structs

from fleet.checks.own_checks import OwnChecks
from fleet.recorder.connectivity import Connectivity
from fleet.recorder.metrics import Metrics, VehicleError
from fleet.recorder.program_failures import ProgramFailures
from fleet.recorder.separation import Separation
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.sections.fault_entry import DIVERGED, TUMBLED, vehicle_entry
from fleet.scenario.sections.timeline import Event, event_order
from netem.ages import Ages
from netem.errors import OutOfPlace
from netem.ledger import Ledger
from netem.lives import Absence
from netem.wire.codec import decode
from netem.wire.messages import Command, Fate, Frame, LinkReport

MOST_OF_NAME = 20  # characters of a node's name in the id of its death: ids have 32


class Spell(NamedTuple):
    """A vehicle is tumbled from tick `begin` to before `end` (None: to the end of the run)."""

    vehicle: int
    begin: int
    end: int | None = None


class JournalSink(Protocol):
    """Where the journal writes: a log, or memory."""

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None: ...
    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...


class Journal:
    """Orders, judges and records what the world and netem report. In-process and distributed runs share it."""

    def __init__(
        self,
        scenario: Scenario,
        log: JournalSink,
        whole: AbstractContextManager[None] | None = None,
        checks: OwnChecks | None = None,
    ) -> None:
        """Begin an empty journal. `log` receives everything in order, and so do the user's `checks`; None: there are
        none, or nothing is judged. `whole` is entered around writes that must not be interrupted half way.
        """
        self.log = log
        self.checks = checks
        self._whole = nullcontext() if whole is None else whole
        self.metrics = Metrics(scenario)
        self.ledger = Ledger(scenario.graph.links)
        self.ages = Ages(scenario.graph.links, from_first_packet=bool(scenario.nodes))
        self.separation = Separation.from_scenario(scenario)
        self.connectivity = Connectivity.from_scenario(scenario)
        self.failures = ProgramFailures()
        self.happened: list[Event] = []  # events that are written already
        self.begin = 0  # the tick at which the run begins; another one if it goes on from another run
        self.written = -1  # complete in the log up to this tick
        self.framed = -1
        self.reported = -1
        self.closed = False
        self._last = scenario.ticks
        # Robots that are not ours are not measured.
        still = VehicleError((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), 0.0)
        self._unmeasured = dict.fromkeys(range(1, scenario.vehicles + 1), still) if scenario.nodes else None
        self._events = deque(scenario.faults.events)
        self._planned_deaths = {(absence.vehicle, absence.begin) for absence in scenario.faults.absences}
        self.active: list[str] = []  # faults that last, in the order in which they began
        self._names = {event.fault for event in self._events}  # ids of faults that are taken
        self._vehicle_name = scenario.vehicle_name
        self.deaths: dict[int, Event] = {}  # vehicle -> a death that was not planned, while it lasts
        self.died: list[Event] = []  # deaths that were not planned and divergences, as they came
        self.diverged: dict[int, Event] = {}  # vehicle -> that its motion left the finite numbers
        self.tumbled: dict[int, Event] = {}  # vehicle -> that it tumbled, while it lasts
        self.tumbles: list[Spell] = []  # every tumble, in the order of their beginnings
        self._frame_every = frame_every(scenario)
        self._round_ticks = scenario.round_ticks
        self._frames: deque[Frame] = deque()
        self._parts: list[Frame] = []  # parts of a frame whose rest is still to come
        self._fates: deque[Fate] = deque()

    def take_over(
        self, tick: int, before: Journal, diverged: Iterable[int], tumbled: Mapping[int, tuple[int, int]]
    ) -> None:
        """Begin at a tick to which another run was made: what was before counts in the ledger, and in nothing else.

        Args:
            tick: a round tick with a frame.
            before: the journal of the other run.
            diverged: the vehicles that are not integrated any more.
            tumbled: by vehicle that is tumbled, how often it has tumbled and since which tick.
        """
        self.begin = tick
        self.written, self.framed, self.reported = tick - 1, tick - self._frame_every, tick - self._round_ticks
        self.ledger = before.ledger
        self.ages.begin(tick, before.ages)
        if self.connectivity is not None:
            self.connectivity.begin(tick)
        while self._events and self._events[0].tick < tick:
            self._happens(self._events.popleft())
        for i in diverged:
            self._happens(self._diverges(i, tick))
        for i, (number, since) in sorted(tumbled.items()):
            self._happens(self._tumbles_from(i, since, number))

    @property
    def complete(self) -> bool:
        """Whether everything up to the end tick is written."""
        return self.closed and self.written >= self._last

    def end_at(self, tick: int) -> None:
        """End the run at a tick earlier than planned: robots that are not ours run until somebody ends them."""
        self._last = tick

    def finish(self) -> None:
        """Bring what counts ticks up to what is written; nothing comes after that."""
        ticks = min(self.written + 1, self._last)  # the last one is never started
        self.ages.count(ticks)
        if self.connectivity is not None:
            self.connectivity.close(ticks)

    def frame(self, frame: Frame) -> None:
        """Take the world's next frame. Raises OutOfPlace if a frame is missing."""
        expected = 0 if self.framed < 0 else min(self.framed + self._frame_every, self._last)
        if frame.tick != expected:
            raise OutOfPlace("frame", expected, frame.tick)
        self._parts.append(frame)
        if frame.more:
            return
        self.framed = frame.tick
        self._frames.append(frame if len(self._parts) == 1 else _join_parts(self._parts))
        self._parts = []
        self._write()

    def links(self, report: LinkReport) -> None:
        """Take netem's next report. Raises OutOfPlace if a report is missing."""
        expected = 0 if self.reported < 0 else self.reported + self._round_ticks
        if not report.closing and report.until != expected:
            raise OutOfPlace("link report", expected, report.until)
        self._fates.extend(report.fates)
        if report.more:
            return
        self.reported = report.until
        self.closed = report.closing
        self._write()

    def write_up(self, tick: int, fates: Iterable[Fate]) -> None:
        """Write everything up to a tick, with the fates of the round that is not reported yet."""
        self._fates.extend(fates)
        self._write_up_to(tick)

    def _write(self) -> None:
        limit = min(self.framed, self.reported)
        if limit > self.written:
            with self._whole:
                self._write_up_to(limit)

    def _write_up_to(self, limit: int) -> None:
        while self._frames and self._frames[0].tick <= limit:
            frame = self._frames.popleft()
            self._write_fates(frame.tick - 1)
            commands = {row.id: _command(row.command) for row in frame.vehicles if row.command}
            self._write_events(frame)
            errors = self._unmeasured or self.metrics.frame(frame, commands)
            self.log.frame(frame, commands, errors)
            self.failures.frame(frame)
            if self.checks is not None:
                self.checks.frame(frame, commands, errors)
            if self.separation is not None:
                self.separation.frame(frame)
        self._write_fates(limit)
        self.written = limit

    def add_event(self, event: Event) -> None:
        """Take a fault that was injected, behind those of the same tick."""
        self._names.add(event.fault)
        place = sum(event_order(other) <= event_order(event) for other in self._events)
        self._events.insert(place, event)

    def end_event(self, fault: str, tick: int) -> None:
        """End a fault earlier than planned. If it has not begun, remove it."""
        if any(e.fault == fault and e.action == "begins" and e.tick >= tick for e in self._events):
            self._events = deque(e for e in self._events if e.fault != fault)
            return
        for event in [e for e in self._events if e.fault == fault and e.action == "ends"]:
            self._events.remove(event)
            self.add_event(replace(event, tick=tick))

    def tell_deaths(self, absences: Iterable[Absence]) -> None:
        """These are faults that have an event already."""
        self._planned_deaths.update((absence.vehicle, absence.begin) for absence in absences)

    def _write_events(self, frame: Frame) -> None:
        for life in frame.lives:
            i = life.vehicle
            if life.begins and i in self.deaths:
                self.add_event(replace(self.deaths.pop(i), tick=life.tick, action="ends"))
            elif not life.begins and life.tick < self._last and (i, life.tick) not in self._planned_deaths:
                if life.diverged:
                    # This event was not injected, so it comes again when the scenario is run again.
                    self.add_event(self._diverges(i, life.tick))
                    continue
                who = self._vehicle_name(i)
                name = self._name(f"death-{who.replace('.', '-')[:MOST_OF_NAME]}")
                self.deaths[i] = Event(life.tick, name, "begins", f"kill {who}", vehicle_entry("kill", i))
                self.died.append(self.deaths[i])
                self.add_event(self.deaths[i])
        for tumble in frame.tumbles:
            if tumble.begins:
                event = self._tumbles_from(tumble.vehicle, tumble.tick, tumble.number)
                if tumble.tick < self._last:  # otherwise nothing is left of the run for it to last
                    self.add_event(event)
            else:
                spell = max(n for n, spell in enumerate(self.tumbles) if spell.vehicle == tumble.vehicle)
                self.tumbles[spell] = self.tumbles[spell]._replace(end=tumble.tick)
                self.add_event(replace(self.tumbled.pop(tumble.vehicle), tick=tumble.tick, action="ends"))
        if frame.tick == self._last:
            for lasts in (*self.deaths.values(), *self.diverged.values(), *self.tumbled.values()):
                self.add_event(replace(lasts, tick=frame.tick, action="ends"))
        while self._events and self._events[0].tick <= frame.tick:
            event = self._events.popleft()
            self._happens(event)
            self.log.event(event)

    def _diverges(self, i: int, tick: int) -> Event:
        entry = vehicle_entry(DIVERGED, i)
        self.diverged[i] = event = Event(tick, f"{DIVERGED}-{i}", "begins", f"{DIVERGED} {i}", entry)
        self.died.append(event)
        return event

    def _tumbles_from(self, i: int, tick: int, number: int) -> Event:
        self.tumbles.append(Spell(i, tick))
        name = self._name(f"{TUMBLED}-{i}" if number == 1 else f"{TUMBLED}-{i}-{number}")
        event = Event(tick, name, "begins", f"{TUMBLED} {i}", vehicle_entry(TUMBLED, i))
        if tick < self._last:
            self.tumbled[i] = event
        return event

    def _name(self, wanted: str) -> str:
        """An id for an event that was not planned: `wanted`, or with a number behind it if that is taken."""
        names = (wanted if n == 1 else f"{wanted}-{n}" for n in count(1))
        return next(name for name in names if name not in self._names)

    def _happens(self, event: Event) -> None:
        self.happened.append(event)
        if self.checks is not None:
            self.checks.event(event)
        if not event.is_fault:
            return
        if event.action == "begins":
            self.active.append(event.fault)
        elif event.fault in self.active:
            self.active.remove(event.fault)

    def _write_fates(self, until: int) -> None:
        final = []
        while self._fates and self._fates[0].final_tick <= until:
            final.append(self._fates.popleft())
        self.ledger.settle(final)
        for fate in final:
            self.ages.settle(fate)
            if self.connectivity is not None:
                self.connectivity.settle(fate)
            if self.checks is not None:
                self.checks.settle(fate)
            self.log.packet(fate)


def _join_parts(parts: list[Frame]) -> Frame:
    return structs.replace(
        parts[-1],
        vehicles=tuple(row for part in parts for row in part.vehicles),
        lives=tuple(life for part in parts for life in part.lives),
        tumbles=tuple(tumble for part in parts for tumble in part.tumbles),
        said=tuple(line for part in parts for line in part.said),
    )


def _command(data: bytes) -> Command:
    command = decode(data)
    assert isinstance(command, Command)  # the world checked it before it went into the frame
    return command
