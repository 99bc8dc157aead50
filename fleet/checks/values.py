"""The input of checks and measures at a tick: the values of every vehicle's signals, as the log has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot, nan, sqrt
from typing import Protocol

from fleet.scenario.sections.signals import BELIEF, LOCATED, ROLL, WHERE_LOCATED
from netem.wire.messages import Command, Frame, VehicleFrame
from world.signal import width_of
from world.vectors import Vec3

BELIEF_SIZE = sum(signal.width for signal in BELIEF)
_UNKNOWN: tuple[float, ...] = (nan,) * 10  # a replayed error has no covariance


class OffPlace(Protocol):
    """The true formation error of a vehicle: its position minus its desired position [m, NED]."""

    @property
    def formation(self) -> Vec3: ...


def belief_values(row: VehicleFrame, error: OffPlace) -> tuple[float, ...]:
    """The values of the topic `belief` in the order of `BELIEF`; `error` is the true formation error. Empty if no agent
    got a measurement of this vehicle at this tick.

    | symbol | meaning | unit |
    |---|---|---|
    | P | covariance of the estimate of x, y, z (NED) and psi | m^2, m rad, rad^2 |
    | d | the estimate minus the truth, NED | m |
    | NEES = d^T P^-1 d | of x, y, z: of a consistent filter it is chi-square with 3 degrees of freedom | 1 |
    """
    if not row.nav:
        return ()
    p = row.belief or _UNKNOWN
    dx, dy, dz = (believed - true for believed, true in zip(row.nav[:3], row.eta[:3], strict=True))
    fx, fy, fz = error.formation
    bx, by, bz = fx + dx, fy + dy, fz + dz
    deviations = [sqrt(max(0.0, value)) if value == value else nan for value in (p[0], p[4], p[7], p[9])]
    return (
        *deviations, *p, dx, dy, dz, hypot(dx, dy, dz), _nees(p, (dx, dy, dz)), bx, by, bz, hypot(bx, by, bz)
    )  # fmt: skip


def _nees(p: Sequence[float], d: Vec3) -> float:
    """d^T P^-1 d; NaN of a covariance that has no inverse."""
    xx, xy, xz, _, yy, yz, _, zz, _, _ = p
    x, y, z = d
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * c
    if not determinant > 0.0:
        return nan
    e, f, g = xx * zz - xz * xz, xz * xy - xx * yz, xx * yy - xy * xy
    return (a * x * x + e * y * y + g * z * z + 2.0 * (b * x * y + c * x * z + f * y * z)) / determinant


LOCATED_SIZE = width_of(LOCATED)


def located_values(row: VehicleFrame, telemetry: Sequence[float]) -> tuple[float, ...]:
    """The values of the topic `located`, flat; empty: the agent has reported nothing.

    It is where a vehicle believes to be by its navigator and by ranges, against the truth.

    | symbol | meaning | unit |
    |---|---|---|
    | P | covariance of north and east | m^2 |
    | d | the estimate minus the truth, north and east | m |
    | NEES = d^T P^-1 d | of a consistent estimate it is chi-square with 2 degrees of freedom | 1 |
    """
    if not telemetry:
        return ()
    x, y, z, nn, ne, ee = telemetry[WHERE_LOCATED]
    dx, dy = x - row.eta[0], y - row.eta[1]
    determinant = nn * ee - ne * ne
    nees = (ee * dx * dx - 2.0 * ne * dx * dy + nn * dy * dy) / determinant if determinant > 0.0 else nan
    deviations = [sqrt(value) if value >= 0.0 else nan for value in (nn, ee)]
    return (x, y, z, nn, ne, ee, *deviations, dx, dy, hypot(dx, dy), nees)


Values = tuple[float, ...]
ROLL_SIZE = len(ROLL)


class Error(Protocol):
    """How far a vehicle is from where it should be, by both measures [m, NED]."""

    @property
    def e(self) -> Vec3: ...
    @property
    def e_norm(self) -> float: ...
    @property
    def formation(self) -> Vec3: ...
    @property
    def formation_norm(self) -> float: ...


class TickValues(Protocol):
    @property
    def tick(self) -> int: ...

    def values(self, i: int, group: str) -> Values:
        """The values of a topic group of vehicle i, flat; empty if the log has no sample of it at this tick."""


def values_of(group: str, row: VehicleFrame, command: Command | None, error: Error) -> Values:
    """The values of a topic group of a vehicle, flat; empty if there are none."""
    match group:
        case "state":
            return (*row.eta, *row.nu, *row.plant[:ROLL_SIZE])
        case "plant":
            return tuple(row.plant[ROLL_SIZE:])
        case "clock":
            return tuple(row.clock)
        case "nav":
            return tuple(row.nav)
        case "belief":
            return belief_values(row, error)
        case "located":
            return () if command is None else located_values(row, command.telemetry)
        case "error":
            return (*error.e, error.e_norm, *error.formation, error.formation_norm)
        case "command":
            return () if command is None else (*command.tau, *row.tau)
        case _:
            return () if command is None else command.telemetry


class FrameValues:
    """The values of a frame, of the groups with a sample in the log at its tick."""

    def __init__(
        self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, Error], due: frozenset[str]
    ) -> None:
        self.tick = frame.tick
        self._rows, self._commands, self._errors, self._due = frame.vehicles, commands, errors, due

    def values(self, i: int, group: str) -> Values:
        if group not in self._due:
            return ()
        return values_of(group, self._rows[i - 1], self._commands.get(i), self._errors[i])


class LoggedValues:
    """The values of a tick as they were read from a log."""

    def __init__(self, tick: int, found: Mapping[tuple[int, str], Values]) -> None:
        """`found`: by vehicle and topic group."""
        self.tick = tick
        self._found = found

    def values(self, i: int, group: str) -> Values:
        return self._found.get((i, group), ())
