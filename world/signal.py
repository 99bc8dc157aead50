"""The declaration of one value that a control law or a plant reports, so that logs, tables and plots can name it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """One named value of a law or a plant: a number, or `width` of them. The unit is "1" when it has none."""

    name: str
    unit: str
    meaning: str
    width: int = 1


def width_of(signals: Iterable[Signal]) -> int:
    return sum(signal.width for signal in signals)
