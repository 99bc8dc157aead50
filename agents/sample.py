"""The input of a control law at one control sample, what guidance asks of tracking, and the answer of an agent."""

from __future__ import annotations

from random import Random
from typing import NamedTuple

from agents.trajectory import Motion
from netem.wire.messages import Said
from world.vectors import Vec3, Vec5


class NeighbourState(NamedTuple):
    """An agent's knowledge of one neighbour that it has heard."""

    id: int  # its number, from 1
    weight: float  # a_ij [1]
    offset: Vec3  # Delta_ij = p_i - p_j, what to keep from it [m, NED]
    position: Vec3  # where it should be now, extrapolated as the scenario says [m, NED]
    velocity: Vec3  # over ground, when it sent [m/s, NED]
    age: float  # time since it sampled what it sent [s], by its clock and the own one
    range_m: float | None = None  # to it, as the modem measured it with that message [m]; None: it did not
    range_sd_m: float | None = None  # standard deviation of the range, as the modem knows it [m]


class VelocityCommand(NamedTuple):
    """The demand of guidance on tracking."""

    speed: float  # m/s
    theta: float  # pitch of the velocity [rad, NED], up > 0
    psi: float  # course of the velocity [rad, NED], from north to east


class Sample(NamedTuple):
    """All that a law may know at one control sample."""

    tick: int  # counts samples in simulated time, however the vehicle's clock goes
    t: float  # time by the vehicle's clock [s]; simulated time where none is set
    dt: float  # simulated time since the previous sample [s]; one tick, and more after samples that were missed
    eta: Vec5  # own measured x, y, z [m, NED], theta, psi [rad]
    nu: Vec5  # own measured u, v, w [m/s, body, over ground], q, r [rad/s]
    velocity: Vec3  # own velocity over ground [m/s, NED]
    desired: Motion  # where this vehicle should be now, and how it should move: the reference plus its own offset; of a
    #                  vehicle that does not know the reference: the mean over its neighbours, see agents/agent.py
    neighbours: tuple[NeighbourState, ...]  # those heard so far, by number
    e: Vec3  # consensus error [m, NED], eq. (8)
    c: float  # sum of the weights in e [1]
    seed: str  # seed of this vehicle's random numbers at this tick
    roll: tuple[float, ...] = ()  # own measured phi [rad], p [rad/s] of a vehicle with a plant; in `velocity` already
    belief: tuple[float, ...] = ()  # covariance of own x, y, z, psi [m, rad]: upper triangle, row by row; () if unknown

    def rng(self) -> Random:
        """Make the random generator of this vehicle and tick; call this once per sample.

        Returns:
            A generator seeded from (scenario seed, vehicle, tick). So a law needs no memory of it, and what it draws
            does not depend on earlier draws.
        """
        return Random(self.seed)


class Decision(NamedTuple):
    """The command to the vehicle, and the values for the log."""

    tau: Vec3  # surge force [N], pitch and yaw moment [N m], within the actuators' limits
    telemetry: tuple[float, ...]  # the values of the declared signals, in order
    said: tuple[Said, ...] = ()  # lines for the log


class Step(NamedTuple):
    """A decision, and what to send to the neighbours."""

    tau: Vec3
    telemetry: tuple[float, ...]
    payloads: tuple[bytes, ...]  # none between round ticks
