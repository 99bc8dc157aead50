"""BlueROV2 Heavy, a small ROV with eight thrusters, in six degrees of freedom.

| symbol | meaning | unit |
|---|---|---|
| f1..f4 | thrust of the horizontal thrusters: bow starboard, bow port, stern starboard, stern port; ahead > 0 | N |
| f5..f8 | thrust of the vertical thrusters, in the same order; upwards > 0 | N |
| X, M, N | commanded surge force, pitch moment, yaw moment | N, N m |

Hull, damping, geometry and thrusters come from a pool test. Its authors are M. von Benzon, F. F. Sorensen, E. Uth, J.
Jouffroy, J. Liniger and S. Pedersen identified in a pool: "An Open-Source Benchmark Simulator: Control of a BlueROV2
Underwater Robot", Journal of Marine Science and Engineering 10(12), 1898 (2022). The equations are Fossen's, with the
Coriolis forces and Munk moments of the added mass. There is no tether.

A real BlueROV2 can push to the side and upwards; the command of a plant cannot say so. The allocation asks for no force
there. Drag limits sway and heave, and buoyancy limits roll. The vehicle reaches a depth by pitching and going ahead. No
loop of its own holds anything. So the vehicle is as underactuated as the protocols that drive it suppose, and drifts,
sinks or rises when the water or its weight make it (docs/background/plants.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, exp, pi, sin
from typing import ClassVar

from world.api import PlantConfig, PlantState, Signal, Vec3, Vec6, Water
from world.plants.rigid_body import RigidBody, SixDegrees, added_coriolis, euler_rates, flow, rk4, rotation, to_earth

G = 9.82  # [m/s^2]: table A1, as all numbers down to THRUST_MAX where nothing else is said
FRESH_WATER = 1000.0  # density of the pool [kg/m^3]
MASS = 13.5  # [kg]
VOLUME = 0.0134  # displaced [m^3]: in fresh water 0.98 N too heavy, in sea water (1025 kg/m^3) 2.3 N too light
INERTIA: Vec3 = (0.26, 0.23, 0.37)  # about x, y, z [kg m^2], from CAD
Z_B = -0.01  # centre of buoyancy below that of gravity [m]: it lies above
ADDED: Vec6 = (6.36, 7.12, 18.68, 0.189, 0.135, 0.222)  # added mass [kg, kg m^2]
LINEAR: Vec6 = (13.7, 0.0, 33.0, 0.0, 0.8, 0.0)  # damping [N s/m, N m s]
QUADRATIC: Vec6 = (141.0, 217.0, 190.0, 1.19, 0.47, 1.5)  # damping [N s^2/m^2, N m s^2]

HORIZONTAL: Vec3 = (
    0.156,
    0.111,
    0.085,
)  # |x|, |y|, z of the horizontal thrusters [m, body]: below the centre of gravity
VERTICAL = (0.12, 0.218)  # |x|, |y| of the vertical ones, at the height of the centre of gravity [m, body]
ANGLE = pi / 4.0  # between the horizontal thrusters and the axis x [rad]
THRUST_MAX = 30.4  # thrust of each, ahead and astern [N]: the T200's curve at full voltage, equation (18)
# The thrusters answer with (6136 s + 108700) / (s^3 + 89 s^2 + 9258 s + 108700), equation (19). A lag of first order
# with the same mean delay, (9258 - 6136) / 108700, takes its place: it gives the same speed after a tenth of a second.
T_THRUSTER = (9258.0 - 6136.0) / 108700.0  # 0.0287 [s]

_FORWARD, _SIDEWAYS = cos(ANGLE), sin(ANGLE)
_YAW_ARM = HORIZONTAL[0] * _SIDEWAYS + HORIZONTAL[1] * _FORWARD  # 0.189 [m]


def wrench(thrust: tuple[float, ...]) -> Vec6:
    """The forces and moments [N, N m, body] of eight thrusts [N]: B f, from the geometry."""
    f1, f2, f3, f4, f5, f6, f7, f8 = thrust
    # The bow thrusters push ahead and inwards, those at the stern ahead and outwards.
    X = _FORWARD * (f1 + f2 + f3 + f4)
    Y = _SIDEWAYS * (-f1 + f2 + f3 - f4)
    x, y = VERTICAL
    return (
        X,
        Y,
        -(f5 + f6 + f7 + f8),
        y * (-f5 + f6 - f7 + f8) - HORIZONTAL[2] * Y,
        x * (f5 + f6 - f7 - f8) + HORIZONTAL[2] * X,
        _YAW_ARM * (-f1 + f2 - f3 + f4),
    )


def allocation(X: float, M: float, N: float) -> tuple[float, ...]:
    """The thrusts [N] with the least sum of squares that make a surge force, a pitch and a yaw moment and nothing else.

    That is B+ (X, 0, 0, 0, M, N) with the pseudo-inverse B+ = B' (B B')^-1, written out: X, and the moment in pitch
    that is not the horizontal thrusters' own, are shared by thrusters whose columns of B are orthogonal. Where a thrust
    would be beyond its limit, all are made smaller by the same factor: the direction of the command is kept.
    """
    ahead = X / (4.0 * _FORWARD)
    turn = N / (4.0 * _YAW_ARM)
    lift = (M - HORIZONTAL[2] * X) / (4.0 * VERTICAL[0])
    most = max(abs(ahead) + abs(turn), abs(lift))
    k = THRUST_MAX / most if most > THRUST_MAX else 1.0
    ahead, turn, lift = k * ahead, k * turn, k * lift
    return ahead - turn, ahead + turn, ahead - turn, ahead + turn, lift, lift, -lift, -lift


class BlueROV2(SixDegrees):
    """BlueROV2 Heavy: the state is pose, velocity and the eight thrusts."""

    model: ClassVar[str] = "bluerov2"
    signals: ClassVar[tuple[Signal, ...]] = (
        Signal("thrust", "N", "Thrust of each thruster: 4 horizontal (ahead > 0), 4 vertical (upwards > 0)", 8),
    )
    # What each could be alone.
    limits: Vec3 = (4.0 * _FORWARD * THRUST_MAX, 4.0 * VERTICAL[0] * THRUST_MAX, 4.0 * _YAW_ARM * THRUST_MAX)

    def __init__(self, config: PlantConfig, density: float = FRESH_WATER) -> None:
        """A vehicle in water of a density [kg/m^3], which decides whether it sinks or rises."""
        if not (isinstance(density, (int, float)) and 900.0 <= density <= 1100.0):
            raise ValueError(f"expected density as 900 to 1100 kg/m^3, got {density!r:.80}")
        ix, iy, iz = INERTIA
        self.body = RigidBody(MASS, ix, iy, iz, 0.0, ADDED, weight=MASS * G, buoyancy=density * VOLUME * G, z_b=Z_B)

    def start(self, pose: Vec6, velocity: Vec6) -> PlantState:
        return (*pose, *velocity, *(0.0,) * 8)

    def step(self, state: PlantState, tau: Vec3, water: Water, dt: float) -> PlantState:
        thrust, commanded = state[12:], allocation(*tau)
        # Each thrust goes from f0 to f as f + (f0 - f) exp(-t/T). The hull feels the mean of the step, which gives it
        # exactly the momentum, so the length of the step is not bounded by this lag.
        left = exp(-dt / T_THRUSTER)
        share = (1.0 - left) * T_THRUSTER / dt
        mean = wrench(tuple([f + (f0 - f) * share for f0, f in zip(thrust, commanded, strict=True)]))
        force = tuple([a + b for a, b in zip(mean, water.wrench, strict=True)])
        motion = rk4(lambda motion: self._rate(motion, force, water.current), state[:12], dt)
        return (*motion, *[f + (f0 - f) * left for f0, f in zip(thrust, commanded, strict=True)])

    def _rate(self, motion: PlantState, force: PlantState, current: Vec3) -> PlantState:
        """The time derivative of pose and velocity under a force and moment [N, N m, body]."""
        _, _, _, phi, theta, psi, u, v, w, p, q, r = motion
        R = rotation(phi, theta, psi)
        (ur, vr, wr), (du, dv, dw) = flow(R, (u, v, w), (p, q, r), current)
        nu_r = (ur, vr, wr, p, q, r)
        inertial = self.body.coriolis(nu_r)
        carried = added_coriolis(ADDED, nu_r)
        restoring = self.body.restoring(phi, theta)
        drag = [(d1 + d2 * abs(s)) * s for d1, d2, s in zip(LINEAR, QUADRATIC, nu_r, strict=True)]
        terms = zip(force, inertial, carried, restoring, drag, strict=True)
        X, Y, Z, K, M, N = [f - a - b - c - d for f, a, b, c, d in terms]
        u_dot, v_dot, w_dot, p_dot, q_dot, r_dot = self.body.acceleration((X, Y, Z, K, M, N))
        return (
            *to_earth(R, (u, v, w)), *euler_rates(phi, theta, p, q, r),
            u_dot + du, v_dot + dv, w_dot + dw, p_dot, q_dot, r_dot,
        )  # fmt: skip

    def report(self, state: PlantState) -> Mapping[str, tuple[float, ...]]:
        return {"thrust": state[12:]}
