"""The events of a run as a set of small numbers. A run is new for a search if it has a new number.

A feature is what a vehicle's agent was in while some kinds of faults were active: its whole-number signals, such as who
it takes for the leader. Counts that grow are taken by their powers of two, or every tick would be new.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import blake2b

from fleet.recorder.journal import Watcher
from fleet.recorder.metrics import VehicleError
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Command, Frame

SPACE = 2**16  # features are numbers below this
MOST = 4096  # of one run
_LARGEST = 1e9


class SeenStates:
    """Watches a run for what it goes through."""

    def __init__(self, scenario: Scenario, watcher: Watcher) -> None:
        """Begin; everything is passed on to `watcher`."""
        self._watcher = watcher
        self._events = [event for event in scenario.faults.events if event.is_fault]
        self._next = 0
        self._active: dict[str, str] = {}  # what faults do, by their ids
        self._places = {
            i: [
                place.start
                for _, signal, place in scenario.layout(i).signals()
                if signal.width == 1 and signal.unit == "1"
            ]
            for i in range(1, scenario.vehicles + 1)
        }
        self._found: set[tuple[object, ...]] = set()

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        """Take a frame."""
        self._watcher.frame(frame, commands, errors)
        while self._next < len(self._events) and self._events[self._next].tick <= frame.tick:
            event = self._events[self._next]
            self._next += 1
            if event.action == "begins":
                self._active[event.fault] = event.what.partition(" ")[0]
            else:
                self._active.pop(event.fault, None)
        if len(self._found) >= MOST:
            return
        faults = tuple(sorted(set(self._active.values())))
        first: list[int] = []
        for i, places in self._places.items():
            command = commands.get(i)
            telemetry = command.telemetry if command is not None else ()
            state = tuple(_whole(telemetry[place]) for place in places) if telemetry else ()
            self._found.add((faults, i, state))
            first += state[:1]
        self._found.add((faults, tuple(sorted(first))))

    def features(self) -> list[int]:
        """The events of the run, as numbers."""
        digests = (blake2b(repr(each).encode(), digest_size=2).digest() for each in self._found)
        return sorted({int.from_bytes(digest, "little") for digest in digests})


def _whole(value: float) -> int:
    """A whole number as a state: up to 16 as it is, larger ones by their powers of two; -1: none."""
    if not 0.0 <= value <= _LARGEST or value != int(value):
        return -1
    return int(value) if value <= 16 else 12 + int(value).bit_length()
