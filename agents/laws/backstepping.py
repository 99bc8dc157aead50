"""Tracking: backstepping from a commanded speed and direction to forces (eqs. 24-47), in three flavours.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| u, v, w, q, r | velocity over ground, pitch and yaw rate | m/s, rad/s | body | (1) |
| u_a | speed | m/s | - | (3) |
| theta_a, psi_a | pitch and course of the velocity: theta + theta', psi + psi' as printed, or exact | rad | NED | (5) |
| theta', psi' | attack and sideslip angle | rad | body | (4) |
| u_cmd, theta_cmd, psi_cmd | commanded speed, pitch, course | m/s, rad | NED | (12) |
| q_cmd, r_cmd | commanded pitch and yaw rate | rad/s | body | (28), (29) |
| u_err .. r_err | actual minus commanded (in the paper with a tilde) | m/s, rad, rad/s | - | (24)-(29) |
| A1, A2, A3 | stabilising term of the surge, pitch and yaw channel | m/s^2, rad/s^2 | - | (35), (45) |
| tau | surge force, pitch moment, yaw moment, before any limit | N, N m | body | (35), (45) |
| C_r | cos(theta') cos(psi'), kept away from 0 | 1 | - | (35) |

The paper takes for granted that u > 0. Astern the pitch of the velocity falls as the bow rises, so the law as printed
leaves its depth at full speed. With `astern: bow` it steers the bow below ASTERN: theta' and psi' are those of a
vehicle that goes ahead at ASTERN, and thrust acts on u alone. The exact direction is no cure: the vehicle tumbles.

The flavours differ in A alone: -K2 err plus the derivatives of the commands (*backstepping*: BC, BOC), a shunting model
in place of err and no derivatives, which the paper then counts as disturbances (*neurodynamic*: NBC, NBOC), a
saturated switching term (*sliding mode*: BSMC). All derivatives are filtered differences (`agents.laws.angles`).
"""

from __future__ import annotations

from math import asin, atan2, cos, exp, sin
from typing import ClassVar

from agents.config import AgentConfig
from agents.laws.angles import RateFilter, wrap
from agents.laws.kinematics import ASTERN, flow_angles
from agents.sample import Sample, VelocityCommand
from world.signal import Signal
from world.vectors import Vec3


def shunting_step(x: float, s: float, a: float, b_up: float, b_down: float, dt: float) -> float:
    """One step of the shunting model, the bioinspired neuron that bounds and smooths an error (eqs. 43-47).

    | symbol | meaning | unit | paper |
    |---|---|---|---|
    | x | membrane state | unit of s | (43) |
    | s | input, an error held over dt | m/s or rad/s | (43) |
    | a | passive decay | 1/s | Table I |
    | b, b' | upper bound, minus lower bound of x (Table I prints b' as d) | unit of s | (43) |

        x' = -a x + (b - x) max(s, 0) - (b' + x) max(-s, 0)

    Returns the state [unit of s] `dt` [s] later with s held: the exact solution, which is stable for every dt.

    x <- x_ss + (x - x_ss) exp(-(a + |s|) dt), x_ss = b s / (a + |s|), with b' (`b_down`) for b (`b_up`) where s < 0.
    Being a convex combination it keeps x within [-b_down, b_up].
    """
    decay = a + abs(s)
    settled = (b_up if s >= 0.0 else b_down) * s / decay
    return settled + (x - settled) * exp(-decay * dt)


_ERRORS = (
    Signal("u_err", "m/s", "speed minus commanded speed"),
    Signal("theta_err", "rad", "pitch of the velocity minus the commanded one, wrapped"),
    Signal("psi_err", "rad", "course of the velocity minus the commanded one, wrapped"),
    Signal("q_err", "rad/s", "pitch rate minus commanded pitch rate"),
    Signal("r_err", "rad/s", "yaw rate minus commanded yaw rate"),
)
_DEMAND = Signal("demand", "N, N m", "surge force, pitch moment, yaw moment before the limits", 3)
_RATES = Signal("cmd_rate", "m/s^2, rad/s^2", "filtered derivatives of u_cmd, q_cmd, r_cmd", 3)
_COMMON = frozenset(
    {"k_u", "k_q", "k_r", "k_theta", "k_psi", "tau_f", "u_floor", "rho_eps", "cos_eps", "u_eps", "angles", "astern"}
)


class _Backstepping:
    """The common part. Each flavour has its own `_act`, and its own signals between errors and demand."""

    __slots__ = ("_bow", "_exact", "_m", "_params", "filters")

    def __init__(self, config: AgentConfig) -> None:
        p = config.vehicle
        self._params = config.tracking
        self._exact = config.tracking.angles == "exact"
        self._bow = config.tracking.astern == "bow"
        self._m = (*p.inertia, p.beta_u, p.beta_v, p.beta_w, p.beta_q, p.beta_r, p.beta_b)
        # Rates of theta_cmd, psi_cmd, theta', psi', in this order.
        self.filters = tuple(RateFilter(config.tracking.tau_f, angle=True) for _ in range(4))

    def step(self, sample: Sample, command: VelocityCommand) -> tuple[Vec3, tuple[float, ...]]:
        """Answer one sample, eqs. (24)-(47): surge force [N], pitch and yaw moment [N m] before the limits, and the
        values of `signals`, flat.
        """
        k = self._params
        m1, m2, m3, m4, m5, beta_u, beta_v, beta_w, beta_q, beta_r, beta_b = self._m
        dt = sample.dt
        _, _, _, theta, psi = sample.eta
        u, v, w, q, r = sample.nu
        u_cmd, theta_cmd, psi_cmd = command
        rate_theta_cmd, rate_psi_cmd, rate_attack, rate_sideslip = self.filters
        astern = self._bow and u < ASTERN
        ahead = ASTERN if astern else u
        u_a, attack, sideslip = flow_angles(ahead, v, w)
        g = max(u_a, k.u_eps)
        if self._exact:
            sth = sin(theta)
            attack = asin(max(-1.0, min(1.0, (ahead * sth - w * cos(theta)) / g))) - theta
            sideslip = atan2(v, ahead * cos(theta) + w * sth)

        # Errors of speed and direction.
        u_err = (u if astern else u_a) - u_cmd
        theta_err = wrap(theta + attack - theta_cmd)
        psi_err = wrap(psi + sideslip - psi_cmd)

        # Commanded rates of turn.
        cth = cos(theta)
        q_cmd = -k.k_theta * theta_err - rate_attack.step(attack, dt) + rate_theta_cmd.step(theta_cmd, dt)
        r_cmd = cth * (-k.k_psi * psi_err - rate_sideslip.step(sideslip, dt) + rate_psi_cmd.step(psi_cmd, dt))
        q_err = q - q_cmd
        r_err = r - r_cmd
        (A1, A2, A3), inner = self._act((u_err, q_err, r_err), (u_cmd, q_cmd, r_cmd), dt)

        # Surge: thrust acts along the axis, so the speed along the velocity gains by its cosine.
        if astern:
            C, tau1_star = 1.0, 0.0
        else:
            C = u / g
            if -k.cos_eps < C < k.cos_eps:
                C = k.cos_eps if C >= 0.0 else -k.cos_eps
            tau1_star = v / g / m2 * (m1 * u * r + beta_v * v) - w / g / m3 * (m1 * u * q - beta_w * w)
        tau1 = -m2 * v * r + m3 * w * q + beta_u * u + m1 / C * (tau1_star + A1)
        tau2 = -(m3 - m1) * u * w + beta_q * q + beta_b * sin(theta) - m4 * theta_err + m4 * A2
        tau3 = -(m1 - m2) * u * v + beta_r * r - m5 * psi_err / max(cth, k.cos_eps) + m5 * A3
        return (tau1, tau2, tau3), (u_err, theta_err, psi_err, q_err, r_err, *inner, tau1, tau2, tau3)

    def _act(self, errors: Vec3, commands: Vec3, dt: float) -> tuple[Vec3, Vec3]:
        """A1 [m/s^2], A2, A3 [rad/s^2], and the three values that are reported between errors and demand. `errors` are
        those of surge [m/s], pitch and yaw rate [rad/s]; `commands` likewise.
        """
        raise NotImplementedError


class NeurodynamicTracking(_Backstepping):
    """A = -K2 x, x from a shunting model on each error: smooth, bounded, and without derivatives of the commands."""

    signals: ClassVar[tuple[Signal, ...]] = (
        *_ERRORS,
        Signal("x", "m/s, rad/s", "shunting states of u_err, q_err, r_err after the update", 3),
        _DEMAND,
    )
    uses: ClassVar[frozenset[str]] = _COMMON | {"a", "b_up", "b_down"}  # the fields of TrackingParams that it reads

    __slots__ = ("x",)

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self.x: Vec3 = (0.0, 0.0, 0.0)

    def _act(self, errors: Vec3, commands: Vec3, dt: float) -> tuple[Vec3, Vec3]:
        # The shunting states see this sample's errors before they are used: half a sample less delay, and
        # without it the loop is unstable at longer control periods.
        k = self._params
        x1, x2, x3 = self.x
        u_err, q_err, r_err = errors
        x1 = shunting_step(x1, u_err, k.a, k.b_up, k.b_down, dt)
        x2 = shunting_step(x2, q_err, k.a, k.b_up, k.b_down, dt)
        x3 = shunting_step(x3, r_err, k.a, k.b_up, k.b_down, dt)
        self.x = x = (x1, x2, x3)
        return (-k.k_u * x1, -k.k_q * x2, -k.k_r * x3), x


class _WithRates(_Backstepping):
    signals: ClassVar[tuple[Signal, ...]] = (*_ERRORS, _RATES, _DEMAND)

    __slots__ = ("command_rates",)

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self.command_rates = tuple(RateFilter(config.tracking.tau_f) for _ in range(3))

    def _rates(self, commands: Vec3, dt: float) -> Vec3:
        """Filtered derivatives of u_cmd [m/s^2], q_cmd and r_cmd [rad/s^2]."""
        f1, f2, f3 = self.command_rates
        u_cmd, q_cmd, r_cmd = commands
        return f1.step(u_cmd, dt), f2.step(q_cmd, dt), f3.step(r_cmd, dt)


class BacksteppingTracking(_WithRates):
    """A = -K2 err + d(command)/dt: conventional backstepping."""

    uses: ClassVar[frozenset[str]] = _COMMON

    __slots__ = ()

    def _act(self, errors: Vec3, commands: Vec3, dt: float) -> tuple[Vec3, Vec3]:
        k = self._params
        s1, s2, s3 = errors
        d1, d2, d3 = rates = self._rates(commands, dt)
        return (-k.k_u * s1 + d1, -k.k_q * s2 + d2, -k.k_r * s3 + d3), rates


class SlidingModeTracking(_WithRates):
    """A = -K2 sat(err / phi) + d(command)/dt: backstepping sliding mode with a boundary layer phi. The paper names BSMC
    and gives its three gains, not its law; this is the usual one. The sign function itself (phi -> 0) chatters.
    """

    uses: ClassVar[frozenset[str]] = _COMMON | {"phi"}

    __slots__ = ()

    def _act(self, errors: Vec3, commands: Vec3, dt: float) -> tuple[Vec3, Vec3]:
        k = self._params
        s1, s2, s3 = errors
        p1, p2, p3 = k.phi
        d1, d2, d3 = rates = self._rates(commands, dt)
        return (-k.k_u * _sat(s1 / p1) + d1, -k.k_q * _sat(s2 / p2) + d2, -k.k_r * _sat(s3 / p3) + d3), rates


def _sat(s: float) -> float:
    return max(-1.0, min(1.0, s))
