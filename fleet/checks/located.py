"""Where a vehicle believes it is by its navigator and by ranges, against the truth: the values of its topic `located`.

| symbol | meaning | unit |
|---|---|---|
| P | covariance of north and east | m^2 |
| d | the estimate minus the truth, north and east | m |
| NEES = d^T P^-1 d | of a consistent estimate it is chi-square with 2 degrees of freedom | 1 |
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan, sqrt

from fleet.scenario.sections.signals import LOCATED, WHERE_LOCATED
from netem.wire.messages import VehicleFrame
from world.signal import width_of

SIZE = width_of(LOCATED)


def located_values(row: VehicleFrame, telemetry: Sequence[float]) -> tuple[float, ...]:
    """The values of `LOCATED`, flat; empty: the agent has reported nothing."""
    if not telemetry:
        return ()
    x, y, z, nn, ne, ee = telemetry[WHERE_LOCATED]
    dx, dy = x - row.eta[0], y - row.eta[1]
    determinant = nn * ee - ne * ne
    nees = (ee * dx * dx - 2.0 * ne * dx * dy + nn * dy * dy) / determinant if determinant > 0.0 else nan
    deviations = [sqrt(value) if value >= 0.0 else nan for value in (nn, ee)]
    return (x, y, z, nn, ne, ee, *deviations, dx, dy, hypot(dx, dy), nees)
