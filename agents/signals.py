"""The declaration of what a controller reports at every tick, so that logs and plots can name it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """`width` consecutive floats of the telemetry: group, name, unit ("1" when it has none) and meaning."""

    group: str
    name: str
    unit: str
    width: int
    meaning: str
