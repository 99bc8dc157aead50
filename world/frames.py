"""The parts of each frame, collected until it is complete. A frame is the state of all vehicles at one tick."""

from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter
from typing import TypeVar

from netem.wire.messages import Frame, Life, Said, SaidBy, Tumble, VehicleFrame

_Change = TypeVar("_Change", Life, Tumble)


class FrameAssembly:
    """Collects rows and changes by frame; a frame is complete once every vehicle has its row in it."""

    def __init__(self, vehicles: int, ticks: int, every: int) -> None:
        """Begin with the frame of tick 0, of this number of vehicles, one frame in `every` ticks; the end tick always
        has a frame.
        """
        self._vehicles, self._ticks, self._every = vehicles, ticks, every
        self._next = 0  # tick of the next frame
        self._rows: dict[int, list[VehicleFrame]] = {}
        self._lives: dict[int, list[Life]] = {}
        self._tumbles: dict[int, list[Tumble]] = {}
        self._said: dict[int, list[SaidBy]] = {}

    @property
    def finished(self) -> bool:
        return self._next > self._ticks

    def due(self, tick: int) -> bool:
        return tick % self._every == 0

    def row(self, tick: int, row: VehicleFrame) -> None:
        self._rows.setdefault(tick, []).append(row)

    def life(self, life: Life) -> None:
        self._lives.setdefault(self._frame_of(life.tick), []).append(life)

    def tumble(self, tumble: Tumble) -> None:
        self._tumbles.setdefault(self._frame_of(tumble.tick), []).append(tumble)

    def say(self, tick: int, i: int, lines: Iterable[Said]) -> None:
        """Vehicle i's agent says these lines with its command of a tick; on a wall clock its frame may have left."""
        self._said.setdefault(max(self._frame_of(tick), self._next), []).extend(SaidBy(i, line) for line in lines)

    def begin(self, tick: int, before: FrameAssembly) -> None:
        """Begin with the frame of this tick, and with what was said since the last frame of another run."""
        self._tumbles.clear()
        self._said = before._said
        self._next = tick

    def complete(self) -> list[Frame]:
        """The frames that have become complete, in order."""
        frames = []
        while (rows := self._rows.get(self._next)) is not None and len(rows) == self._vehicles:
            tick, last = self._next, self._ticks
            del self._rows[tick]
            rows.sort(key=attrgetter("id"))
            lives = _sort_changes(self._lives.pop(tick, ()))
            tumbles = _sort_changes(self._tumbles.pop(tick, ()))
            said = tuple(sorted(self._said.pop(tick, ()), key=attrgetter("vehicle")))
            frames.append(Frame(tick, False, lives, tumbles, tuple(rows), said))
            self._next = min(last, tick + self._every) if tick < last else last + 1
        return frames

    def _frame_of(self, tick: int) -> int:
        return min(-(-tick // self._every) * self._every, self._ticks)


def _sort_changes(changes: Iterable[_Change]) -> tuple[_Change, ...]:
    """By tick and vehicle; the changes of one vehicle at one tick stay in their order: it began, and ended at once."""
    return tuple(sorted(changes, key=attrgetter("tick", "vehicle")))
