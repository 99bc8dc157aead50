"""The configuration that the world gets before a run: plain, frozen data in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from netem.lives import Absence
from netem.vehicle_clock import VehicleClock
from netem.wire.messages import WorldFault
from world.navigation.config import Navigation
from world.tumble import LIMIT_RAD
from world.vectors import Vec3, Vec5
from world.vehicle_params import VehicleParams

# RK4 steps per tick. At a tick of 10 ms one step stays within 4e-7 of a converged velocity in the paper's
# disturbed runs, two within 3e-8, four within 7e-9; each step costs about 7 us per vehicle.
DEFAULT_SUBSTEPS = 2


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One component of a disturbance: amplitude * sin(omega t + phase) [N or N m, rad/s, rad]."""

    amplitude: float = 0.0
    omega: float = 1.0
    phase: float = 0.0


@dataclass(frozen=True, slots=True)
class NavNoise:
    """Standard deviations of white noise on the navigation sensor; all zero means off."""

    position_m: float = 0.0
    angle_rad: float = 0.0
    velocity_mps: float = 0.0
    rate_radps: float = 0.0

    @property
    def off(self) -> bool:
        """Whether the sensor reports the truth."""
        return not (self.position_m or self.angle_rad or self.velocity_mps or self.rate_radps)


@dataclass(frozen=True, slots=True)
class PlantSetup:
    """The plant of one vehicle, in place of the 5-DOF model; see `world.api`."""

    name: str
    parameters: Mapping[str, Any]
    budget_s: float  # the longest that it may take for a tick [s of wall time]; 0: any time
    phi0: float = 0.0  # roll at the start [rad]
    p0: float = 0.0  # roll rate at the start [rad/s]
    file: str = ""  # where the FMU of the plant lies, which the user has let run; empty: the plant is no FMU


@dataclass(frozen=True, slots=True)
class VehicleSetup:
    """One vehicle of the fleet: its number (1-based), 5-DOF model, actuator limits, initial state, and its plant if its
    motion is that of one."""

    id: int
    eta0: Vec5  # x, y, z [m, NED], theta, psi [rad]
    nu0: Vec5  # u, v, w [m/s, body, over ground], q, r [rad/s]
    params: VehicleParams
    tau_max: Vec3  # N, N m, N m
    tumble_limit: float = LIMIT_RAD  # |pitch| beyond which it tumbles [rad]
    telemetry_size: int | None = None  # how many values a command's telemetry must have; None: any number
    plant: PlantSetup | None = None
    navigation: Navigation | None = None  # None: it knows where it is


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """Everything that determines the world's part of a run."""

    seed: int
    tick_ns: int  # control period Ts
    ticks: int  # the run's duration
    round_ticks: int  # m, ticks per network round
    substeps: int  # RK4 steps per tick
    vehicles: tuple[VehicleSetup, ...]
    disturbance: tuple[Harmonic, ...] = ()  # d1..d5, the same on every vehicle; empty: none
    current: Vec3 = (0.0, 0.0, 0.0)  # m/s, NED, irrotational; the mean
    drift: tuple[Vec3, float] | None = None  # sigma [m/s, NED] and time constant [s] of a Gauss-Markov part
    noise: NavNoise = field(default_factory=NavNoise)
    faults: tuple[WorldFault, ...] = ()  # faults in the order in which they begin
    absences: tuple[Absence, ...] = ()  # when a vehicle has no agent
    clocks: dict[int, VehicleClock] = field(default_factory=dict)  # clocks of the vehicles for which one is set
    moored: bool = False  # vehicles stay where they begin
    keep_going: bool = False  # the run goes on without a vehicle whose motion leaves the finite numbers
