"""The declaration of one value that a control law or a plant reports, so that logs, tables and plots can name it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """One named value of a law or a plant."""

    name: str  # as logs, tables and checks name it
    unit: str  # such as "m/s"; "1" if it has none
    meaning: str  # a few words, for tables and pictures
    width: int = 1  # how many numbers it has


def width_of(signals: Iterable[Signal]) -> int:
    return sum(signal.width for signal in signals)
