"""Collects the parts of each frame until it is complete. A frame is the state of all vehicles at one tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import TypeVar

from netem.wire.messages import Frame, Life, Tumble, VehicleFrame

_Change = TypeVar("_Change", Life, Tumble)


class FrameAssembly:
    """Collects rows and changes by frame; a frame is complete once every vehicle has its row in it."""

    def __init__(self, vehicles: int, ticks: int, every: int) -> None:
        """Begin with the frame of tick 0.

        Args:
            vehicles: number of vehicles, and of rows in a frame.
            ticks: the end tick. It always has a frame.
            every: ticks from one frame to the next.
        """
        self._vehicles, self._ticks, self._every = vehicles, ticks, every
        self._next = 0  # tick of the next frame
        self._rows: dict[int, list[VehicleFrame]] = {}
        self._lives: dict[int, list[Life]] = {}
        self._tumbles: dict[int, list[Tumble]] = {}

    @property
    def finished(self) -> bool:
        """Whether the frame of the end tick was complete."""
        return self._next > self._ticks

    def due(self, tick: int) -> bool:
        """Whether a tick before the end tick has a frame."""
        return tick % self._every == 0

    def row(self, tick: int, row: VehicleFrame) -> None:
        """Add one vehicle at a tick that has a frame."""
        self._rows.setdefault(tick, []).append(row)

    def life(self, life: Life) -> None:
        """Add that a vehicle lost or got its agent."""
        self._lives.setdefault(self._frame_of(life.tick), []).append(life)

    def tumble(self, tumble: Tumble) -> None:
        """Add that a vehicle began to tumble or came back."""
        self._tumbles.setdefault(self._frame_of(tumble.tick), []).append(tumble)

    def resume(self, tick: int) -> None:
        """Go on with the frame of a tick."""
        self._tumbles.clear()
        self._next = tick

    def complete(self, memory: Callable[[int], bytes]) -> list[Frame]:
        """The frames that have become complete, in order.

        Args:
            memory: gives what is remembered of the run before a tick.
        """
        frames = []
        while (rows := self._rows.get(self._next)) is not None and len(rows) == self._vehicles:
            tick, last = self._next, self._ticks
            del self._rows[tick]
            rows.sort(key=attrgetter("id"))
            lives = _in_order(self._lives.pop(tick, ()))
            tumbles = _in_order(self._tumbles.pop(tick, ()))
            frames.append(Frame(tick, False, lives, tumbles, tuple(rows), memory(tick)))
            self._next = min(last, tick + self._every) if tick < last else last + 1
        return frames

    def _frame_of(self, tick: int) -> int:
        """The frame that a change at a tick belongs to: of that tick, or the next one after it."""
        return min(-(-tick // self._every) * self._every, self._ticks)


def _in_order(changes: Iterable[_Change]) -> tuple[_Change, ...]:
    """By tick and vehicle; the changes of one vehicle at one tick stay in their order: it began, and ended at once."""
    return tuple(sorted(changes, key=attrgetter("tick", "vehicle")))
