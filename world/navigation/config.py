"""How the vehicles of a run navigate: plain, frozen data in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from world.vectors import Vec3

FixKind = Literal["gps", "usbl", "lbl"]


@dataclass(frozen=True, slots=True)
class Grade:
    """The errors of a set of instruments; a bias is the standard deviation of what is drawn per run and vehicle."""

    heading_rate: float  # samples per second [Hz], as of each instrument
    heading_bias: float  # rad
    heading_noise: float  # noise of each sample [rad]
    heading_walk: float  # random walk of the bias [rad/sqrt(s)]
    gyro_rate: float
    gyro_bias: float  # rad/s
    gyro_walk: float  # angle random walk [rad/sqrt(s)]
    dvl_rate: float
    dvl_scale: float  # 1
    dvl_noise: float  # noise of each sample and axis [m/s]
    dvl_altitude: float  # above the floor, up to which it sees the floor [m]
    depth_rate: float
    depth_bias: float  # m
    depth_noise: float  # noise of each sample [m]
    tilt: float  # constant error of roll and pitch [rad]


@dataclass(frozen=True, slots=True)
class FixSource:
    """Where a vehicle gets fixes of its horizontal position from."""

    kind: FixKind
    period_ns: int
    delay_ns: int  # from measurement to use
    loss: float  # probability
    noise: float  # standard deviation on each axis [m], next to the beacon
    growth: float  # how much the noise grows per distance [1], as a root of squares
    at: Vec3 = (0.0, 0.0, 0.0)  # the beacon, or the middle of the beacons [m, NED]
    reach: float = 0.0  # greatest distance to it [m]; 0: any
    depth: float = 0.0  # gps: deeper than this there is no fix [m]


@dataclass(frozen=True, slots=True)
class DeadReckoning:
    """How one vehicle navigates by instruments of its own, and by fixes."""

    grade: Grade
    start: float  # standard deviation of the position on each axis at the start [m]
    bottom: float | None  # depth of the floor [m]; None: the DVL always sees it
    current_sigma: float  # the current that the filter expects, a Gauss-Markov process: standard deviation [m/s]
    current_time_s: float  # time constant of that process [s]
    fixes: tuple[FixSource, ...] = ()


@dataclass(frozen=True, slots=True)
class TracePoint:
    """The navigation error of a real vehicle at a time."""

    t: float  # s
    north: float  # estimate minus truth [m]
    east: float
    down: float
    heading: float = 0.0  # rad


@dataclass(frozen=True, slots=True)
class NavigationTrace:
    """One vehicle replays a navigation error, which is linear between its points and constant outside them."""

    points: tuple[TracePoint, ...]  # at least one; ascending in time


Navigation = DeadReckoning | NavigationTrace
