"""One vehicle and its control laws, linearised around steady flight in formation.

| symbol | meaning | unit | frame |
|---|---|---|---|
| v_d | velocity of the formation | m/s | path: ahead, to starboard, down |
| s | deviation of vehicle and laws from steady flight | - | path |
| K e | what the gain makes of the consensus error: rho = v_d - K e | m/s | path |
| y = (p, v) | deviation of position and of velocity over ground | m, m/s | path |
| F, G, C | s(k + 1) = F s(k) + G K e(k), y = C s | - | |

The map over one tick is not derived by hand: the laws' own `step` and the integrator are differentiated by central
differences. So whatever runs (derivative filters, shunting model, hold, RK4) is in it. The gain is outside: one
linearisation serves every gain. Path axes are NED turned about the vertical by the course of v_d.

A function with a corner at steady flight is not linear there: a limit that is reached, slew, a boundary layer of 0.
Limits and slew are inactive for small deviations; the boundary layer of sliding mode is above 0, and inside it the law
is linear.

`Linear` is one tick, and `VehicleRound` a round: what the vehicle does by itself, and what messages do to it. The
symbols of a round are those of `fleet.analysis.border`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin
from typing import Any, NamedTuple

import numpy as np

from agents.config import AgentConfig, Law
from agents.controllers import TRACKING, Cascade
from agents.laws.angles import RateFilter
from agents.laws.kinematics import earth_velocity
from agents.laws.velocity_command import clip
from agents.sample import Sample
from agents.trajectory import Motion
from fleet.errors import FleetError
from world.dynamics import coefficients, rk4_step
from world.vectors import Vec3, Vec5
from world.vehicle_params import VehicleParams

Array = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]
LOOPS = ("speed", "course", "pitch")  # the loops that move a vehicle ahead, to starboard, down
MOST_CONDITION = 1e8  # condition of eigenvectors; at most 1e6 in the scenarios that ship

STEP = 1e-6  # step of the central differences: m, rad, m/s and so on
STEADY = 1e-9  # what may be left per tick of a motion that is called steady
_PLANT = 10  # x, y, z, theta, psi, u, v, w, q, r
_CALM5: Vec5 = (0.0, 0.0, 0.0, 0.0, 0.0)


class NotLinear(FleetError):
    """There is no steady flight to linearise around, or a law that is not ours."""


class Flight(NamedTuple):
    """The inputs of the linearisation of a vehicle."""

    config: AgentConfig  # tracking law, its parameters, the model that it uses; not guidance
    truth: VehicleParams
    tick_s: float
    substeps: int
    velocity: Vec3  # v_d [m/s, NED]
    current: Vec3  # [m/s, NED]


class Linear(NamedTuple):
    """The map of one vehicle over one tick."""

    F: Array  # (n, n)
    G: Array  # (n, 3)
    C: Array  # (6, n)


def linearise(flight: Flight) -> Linear:
    """The linear map of a vehicle. Raises NotLinear for a tracking law that is not ours, or without steady flight at
    this velocity.
    """
    if flight.config.tracking_law.name not in TRACKING:
        raise NotLinear(f"the tracking law {flight.config.tracking_law.name} does not ship with the package")
    vx, vy, vz = flight.velocity
    course = atan2(vy, vx)
    v_d = (hypot(vx, vy), 0.0, vz)
    step, s = _motion(flight, v_d, _turn(flight.current, -course))
    drift = np.zeros(len(s))
    drift[:3] = np.array(v_d) * flight.tick_s
    e = np.zeros(3)
    # Newton: the state but for its position, and the error, such that a tick changes the position by v_d alone.
    for _ in range(12):
        left = step(s, e) - s - drift
        if np.abs(left).max() < STEADY:
            break
        F, G = _derivatives(step, s, e)
        J = np.hstack([(F - np.eye(len(s)))[:, 3:], G])
        change = np.linalg.lstsq(J, -left, rcond=None)[0]
        s[3:] += change[:-3]
        e += change[-3:]
    else:
        raise NotLinear(f"there is no steady flight at {hypot(*v_d):.4g} m/s")
    F, G = _derivatives(step, s, e)
    C = np.zeros((6, len(s)))
    C[:3, :3] = np.eye(3)
    for column in range(3, _PLANT):
        ahead, behind = s.copy(), s.copy()
        ahead[column] += STEP
        behind[column] -= STEP
        C[3:, column] = (_velocity(ahead) - _velocity(behind)) / (2.0 * STEP)
    # What a step only overwrites is no state.
    matters = np.abs(F).max(axis=0) + np.abs(C).max(axis=0) > 1e-12
    return Linear(F[np.ix_(matters, matters)], G[matters], C[:, matters])


Step = Callable[[Array, Array], Array]


def _motion(flight: Flight, v_d: Vec3, current: Vec3) -> tuple[Step, Array]:
    """One tick of vehicle and laws as a function of (s, K e), and the state to start the search from."""
    # The fixed guidance with a gain of 1 and without slew is rho = v_d - K e, and nothing else.
    guidance = replace(flight.config.guidance, K0=(1.0, 1.0, 1.0), slew=0.0)
    config = replace(flight.config, guidance_law=Law("fixed"), guidance=guidance)
    high = config.tau_max
    low = (-high[0], -high[1], -high[2])
    k = coefficients(flight.truth)
    h = flight.tick_s / flight.substeps
    cascade = Cascade(config, [])
    law: Any = cascade.tracking  # one of ours: it can give and take its state
    desired = Motion((0.0, 0.0, 0.0), v_d)

    def decide(s: Array, Ke: Array) -> Vec3:
        x, y, z, theta, psi, u, v, w, q, r = s[:_PLANT].tolist()
        eta, nu = (x, y, z, theta, psi), (u, v, w, q, r)
        e = (float(Ke[0]), float(Ke[1]), float(Ke[2]))
        sample = Sample(0, 0.0, flight.tick_s, eta, nu, earth_velocity(eta, nu), desired, (), e, 1.0, "")
        return clip(cascade.step(sample)[0], low, high)

    plant = np.array([0.0, 0.0, 0.0, -atan2(v_d[2], v_d[0]), 0.0, hypot(*v_d), 0.0, 0.0, 0.0, 0.0])
    decide(plant, np.zeros(3))  # now the filters of the law have a value

    def step(s: Array, Ke: Array) -> Array:
        _set_state(law, s[_PLANT:].tolist())
        tau = decide(s, Ke)
        state = tuple(s[:_PLANT].tolist())
        for _ in range(flight.substeps):
            state = rk4_step(k, state, tau, (_CALM5, _CALM5, _CALM5), h, current)
        return np.array([*state, *_state(law)])

    return step, np.array([*plant, *_state(law)])


def _derivatives(step: Step, s: Array, e: Array) -> tuple[Array, Array]:
    def central(of: Callable[[Array], Array], size: int) -> Array:
        shifts = STEP * np.eye(size)
        return np.array([(of(shift) - of(-shift)) / (2.0 * STEP) for shift in shifts]).T

    return central(lambda shift: step(s + shift, e), len(s)), central(lambda shift: step(s, e + shift), 3)


def _velocity(s: Array) -> Array:
    _, _, _, theta, psi, u, v, w, q, r = s[:_PLANT].tolist()
    return np.array(earth_velocity((0.0, 0.0, 0.0, theta, psi), (u, v, w, q, r)))


def _filters(law: Any) -> list[RateFilter]:
    return [*law.filters, *getattr(law, "command_rates", ())]


def _state(law: Any) -> list[float]:
    """All that the next step of a tracking law of ours depends on: its filters, and perhaps its shunting states."""
    return [*(number for one in _filters(law) for number in (one.value, one.rate)), *getattr(law, "x", ())]


def _set_state(law: Any, numbers: list[float]) -> None:
    """Give it back to the law."""
    filters = _filters(law)
    for place, one in enumerate(filters):
        one.value, one.rate = numbers[2 * place], numbers[2 * place + 1]
    if len(numbers) > 2 * len(filters):
        law.x = tuple(numbers[2 * len(filters) :])


def _turn(vector: Vec3, angle: float) -> Vec3:
    """A vector [NED] turned about the vertical."""
    x, y, z = vector
    c, s = cos(angle), sin(angle)
    return c * x - s * y, s * x + c * y, z


class Link(NamedTuple):
    """A link into a vehicle."""

    sender: int  # counted from 0
    weight: float  # a_ij
    delay: int  # d [ticks]


@dataclass(frozen=True, eq=False, slots=True)
class Member:
    """A vehicle in the fleet's linear map."""

    linear: Linear
    b: float
    links: tuple[Link, ...]
    reckons: bool  # whether it extrapolates with the velocity that a neighbour sent
    age_cap: int | None  # ticks
    pattern: Array  # (3, 3): K is a number times this, path axes
    told: bool = True  # whether it knows v_d; otherwise v_d is the weighted mean of what its neighbours sent

    @property
    def c(self) -> float:
        """Total weight of its consensus error."""
        return self.b + sum(link.weight for link in self.links)


class VehicleRound:
    """A vehicle over one round, with its own feedback. Vehicles that differ only in their neighbours share one."""

    def __init__(self, member: Member, gain: float, m: int, tick_s: float, outputs: int) -> None:
        F, G, C = member.linear
        self.m, self.outputs = m, outputs
        self._C = C[:outputs]
        K = gain * member.pattern
        own = F + member.c * G @ K @ C[:3]
        # What a command at phase f has become at the end of the round: own^(m-1-f) G.
        self._later = np.empty((m, len(F), 3))
        after = G
        for f in range(m - 1, -1, -1):
            self._later[f] = after
            after = own @ after
        self._P = np.linalg.matrix_power(own, m)
        self.poles, vectors = np.linalg.eig(self._P)
        self.unstable = int((np.abs(self.poles) > 1.0).sum())
        self.growth = float(np.abs(self.poles).max())
        # In terms of the eigenvectors of P the resolvent is a division. If eigenvalues meet, the vectors may not span
        # the space, and `resolvent` solves a linear system.
        self._outputs = self._C @ vectors
        simple = np.linalg.cond(vectors) < MOST_CONDITION
        self._inputs: Complex | None = np.linalg.inv(vectors) if simple else None
        self._K, self._heard = K, None if member.told else member.c - member.b
        self._reckons, self._cap, self._tick_s = member.reckons, member.age_cap, tick_s

    def own_mode(self) -> tuple[float, str]:
        """Angle of the largest eigenvalue of P, and the loop that it moves most."""
        at = int(np.argmax(np.abs(self.poles)))
        moved = np.abs(self._outputs[:3, at])
        return abs(float(np.angle(self.poles[at]))), LOOPS[int(np.argmax(moved))]

    def resolvent(self, z: Complex, S: Any) -> Complex:
        """C (z - P)^-1 S at every z, for S (states, outputs)."""
        if self._inputs is None:
            moved: Complex = np.linalg.solve(z[:, None, None] * np.eye(len(S)) - self._P, S.astype(complex)[None])
            return np.asarray(self._C @ moved)
        each = self._outputs.T[:, :, None] * (self._inputs @ S)[:, None, :]  # what an eigenvector carries
        shares: Complex = (1.0 / (z[:, None] - self.poles)) @ each.reshape(len(each), -1)
        return shares.reshape(len(z), *each.shape[1:])

    def answer(self, z: Complex, delay: int) -> Complex:
        """C (z - P)^-1 S(z) for a link with a delay [ticks]."""
        total = np.zeros((len(z), self.outputs, self.outputs), complex)
        phases = np.arange(self.m)
        back = -((phases - delay) // self.m)  # rounds since the message in use was sent
        ages = phases + back * self.m
        if self._cap is not None:
            ages = np.minimum(ages, self._cap)
        for h in sorted({*back.tolist()}):
            used = self._later[back == h]
            S = np.zeros((len(self._P), self.outputs))
            S[:, :3] = used.sum(axis=0) @ self._K
            if self._reckons:
                S[:, 3:] = np.tensordot(ages[back == h] * self._tick_s, used, 1) @ self._K
            if self._heard:
                S[:, 3:] += used.sum(axis=0) / self._heard
            total += (z ** float(-h))[:, None, None] * self.resolvent(z, S)
        return total
