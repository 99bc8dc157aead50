"""Faults and events of a log, from their words."""

from __future__ import annotations

from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.text.fault_words import entry_of_words


def interval(name: str, begin: float, end: float, what: str) -> FaultInterval:
    """A fault, or what befell a vehicle, from `begin` to `end` [s]."""
    return FaultInterval(name, begin, end, what, entry_of_words(what))
