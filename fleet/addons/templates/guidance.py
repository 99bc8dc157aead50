"""TheLaw: a guidance law for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from math import hypot
from typing import Any

from agents.api import AgentConfig, Sample, Signal


class TheLaw:
    """Consensus guidance with a bounded speed: rho = v_d - gain e, shortened to speed_max."""

    # What you report at every sample. It lands in the log under uuv/<i>/guidance, with these units.
    signals = (Signal("shrink", "1", "by how much the command was shortened"),)

    def __init__(self, config: AgentConfig, *, gain: float = 0.3, speed_max: float = 1.2) -> None:
        # What follows the star are parameters: `guidance: {law: "the_law:TheLaw", parameters: {gain: 0.5}}`.
        self._gain = gain
        self._speed_max = speed_max

    def step(self, sample: Sample) -> tuple[tuple[float, float, float], dict[str, Any]]:
        """One control sample: the commanded velocity over ground [m/s, NED]; and the telemetry."""
        # sample.e is the consensus error, sample.desired.velocity how this vehicle should move, sample.neighbours
        # what is known of the others, sample.rng() a random generator for this vehicle and tick.
        x, y, z = (v - self._gain * e for v, e in zip(sample.desired.velocity, sample.e, strict=True))
        shrink = min(1.0, self._speed_max / max(hypot(x, y, z), 1e-9))
        return (shrink * x, shrink * y, shrink * z), {"shrink": shrink}
