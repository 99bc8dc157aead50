"""REMUS 100, a torpedo with one propeller, a rudder and a stern plane, in six degrees of freedom.

| symbol | meaning | unit |
|---|---|---|
| n | revolution of the propeller, never astern | rpm |
| delta_r, delta_s | rudder (positive: to starboard), stern plane (positive: nose down) | rad |
| u_r, v_r, w_r, U_r | velocity through the water in body axes, and its magnitude | m/s |
| X, M, N | surge force, pitch moment, yaw moment | N, N m |

The model is Fossen's: T. I. Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control*, 2nd ed., Wiley 2021,
section 8.4 (torpedo-shaped AUVs), with the propeller and the drag of B. Allen, W. S. Vorus, T. Prestero, "Propulsion
system performance enhancements on REMUS AUVs", OCEANS 2000. docs/background/plants.md compares it with an independent
implementation and says where it deviates and why. With the parameter `hull` the mass, hull and fins come from a fit to
manoeuvres at sea by T. Prestero fitted to manoeuvres at sea (remus100_prestero.py): that hull turns in half the circle,
and is unstable.

The hull is symmetric about its axis: lift and cross-flow drag are the same up and down as to the sides. The Munk
moments and the Coriolis forces that belong to them are left out, as Fossen does: the hull is taken to be neutral in
yaw and pitch.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import atan2, cos, exp, hypot, log, pi, radians, sin, sqrt
from typing import ClassVar, Literal

from world.api import PlantConfig, PlantState, Signal, Vec3, Vec6, Water
from world.plants import remus100_prestero as prestero
from world.plants.rigid_body import RigidBody, SixDegrees, euler_rates, flow, rk4, rotation, to_earth

RHO = 1026.0  # density of sea water [kg/m^3]: Fossen 2021
G = 9.81  # [m/s^2]

# The hull: a spheroid. Fossen 2021, section 8.4.
LENGTH = 1.6  # [m]
DIAMETER = 0.19  # [m]; Prestero 2001, table 2.1: 0.191
Z_G = 0.02  # centre of gravity below that of buoyancy [m]; Prestero 2001, table 2.2: 0.0196
ROLL_ADDED = 0.3  # added moment of inertia in roll over Ix [1]: Fossen 2021

# Lift and drag of the hull. Fossen 2021, section 8.4.
PLAN_AREA = 0.7 * LENGTH * DIAMETER  # [m^2]
C_D0 = 0.42  # drag over frontal area at zero angle of attack [1]: Allen et al. 2000
OSWALD = 0.7  # efficiency of the hull as a wing [1]
C_D_CROSS = 1.2  # drag of a round section across the flow [1]: Hoerner's curve at beam = draught; Prestero 2001: 1.1

# What is left at low speed. Fossen 2021, section 8.4.
T_SURGE = 20.0  # [s], as T_SWAY, which also serves heave: fades with exp(-3 U_r)
T_SWAY = 20.0
ZETA_ROLL = 0.3  # damping over critical [1]
ZETA_PITCH = 0.8
T_YAW = 1.0  # [s]

# Rudder and stern plane, two fins each. Fossen 2021, section 8.4; area: Prestero 2001, table 2.3.
FIN_AREA = 2.0 * 0.00665  # [m^2]
FIN_X = -0.5 * LENGTH  # [m, body]
C_L_RUDDER = 0.5  # lift over angle [1/rad]
C_L_STERN = 0.7
FIN_LIMIT = radians(15.0)  # [rad]
T_FIN = 0.1  # time constant of the servo [s]
SLOW_FLOW = 0.04  # u_r U_r below which fins are turned less and less, since they have no force [m^2/s^2]: chosen

# The propeller: three blades, blade-area ratio 0.718, pitch ratio 1. Fossen 2021 from the Wageningen B-series.
PROPELLER = 0.14  # diameter [m]: 5.5 inches, Allen et al. 2000
N_LIMIT = 1525.0  # [rpm]: 2.5 m/s, Allen et al. 2000
T_N = 1.0  # time constant of motor and propeller [s]
WAKE = 0.944  # advance speed over u_r [1]: Allen et al. 2000
DEDUCTION = 0.1  # part of the thrust that the hull takes back [1]
K_T0, K_Q0 = 0.4566, 0.0700  # thrust and torque at rest [1]
K_T1, K_Q1 = 0.1798, 0.0312  # the same at the advance number J1 [1]
J1 = 0.6632  # 0.944 * 2.5 m/s / (0.14 m * 1525 / 60 s)
TORQUE_SEEN = 0.1  # part of the torque that rolls the hull [1]: Fossen 2021, "to match experimental results"

Hull = Literal["fossen", "prestero"]
HULLS: tuple[Hull, ...] = ("fossen", "prestero")

_SIGNALS = (
    Signal("rpm", "rpm", "revolution of the propeller"),
    Signal("rpm_cmd", "rpm", "commanded revolution"),
    Signal("rudder", "rad", "angle of the rudder, positive turns to starboard"),
    Signal("rudder_cmd", "rad", "commanded angle of the rudder"),
    Signal("stern", "rad", "angle of the stern plane, positive turns the nose down"),
    Signal("stern_cmd", "rad", "commanded angle of the stern plane"),
)


def _spheroid() -> RigidBody:
    """Mass, inertia and added mass (Lamb's factors, Fossen 2021, section 8.4) of the hull."""
    a, b = 0.5 * LENGTH, 0.5 * DIAMETER
    m = 4.0 / 3.0 * pi * RHO * a * b * b
    Ix, Iy = 0.4 * m * b * b, 0.2 * m * (a * a + b * b)
    e2 = 1.0 - (b / a) ** 2  # eccentricity squared
    e = sqrt(e2)
    logarithm = log((1.0 + e) / (1.0 - e))
    alpha = 2.0 * (1.0 - e2) / e**3 * (0.5 * logarithm - e)
    beta = 1.0 / e2 - (1.0 - e2) / (2.0 * e**3) * logarithm
    k1 = alpha / (2.0 - alpha)
    k2 = beta / (2.0 - beta)
    k_turn = e2 * e2 * (beta - alpha) / ((2.0 - e2) * (2.0 * e2 - (2.0 - e2) * (beta - alpha)))
    added = (k1 * m, k2 * m, k2 * m, ROLL_ADDED * Ix, k_turn * Iy, k_turn * Iy)
    below = m * Z_G * Z_G
    return RigidBody(m, Ix + below, Iy + below, Iy, Z_G, added, m * G, m * G)


BODY = _spheroid()
_ASPECT = DIAMETER * DIAMETER / PLAN_AREA
_LIFT = pi * _ASPECT / (1.0 + sqrt(1.0 + 0.25 * _ASPECT * _ASPECT))  # lift over angle of attack [1/rad]
_PARASITIC = C_D0 * 0.25 * pi * DIAMETER**2 / PLAN_AREA
_PRESSURE = 0.5 * RHO * PLAN_AREA
_CROSS = 0.5 * RHO * DIAMETER * C_D_CROSS
_DAMPING: Vec6 = (
    (BODY.m + BODY.added[0]) / T_SURGE,
    (BODY.m + BODY.added[1]) / T_SWAY,
    (BODY.m + BODY.added[2]) / T_SWAY,
    2.0 * ZETA_ROLL * sqrt(BODY.weight * Z_G * (BODY.Ix + BODY.added[3])),
    2.0 * ZETA_PITCH * sqrt(BODY.weight * Z_G * (BODY.Iy + BODY.added[4])),
    (BODY.Iz + BODY.added[5]) / T_YAW,
)
_THRUST = (1.0 - DEDUCTION) * RHO * PROPELLER**4  # surge force over (n / 60)^2 K_T [kg m]
_TORQUE = TORQUE_SEEN * RHO * PROPELLER**5
_FALL_T = (K_T0 - K_T1) / J1 * WAKE / PROPELLER  # how K_T n^2 falls with u_r n [1/m]
_FALL_Q = (K_Q0 - K_Q1) / J1 * WAKE / PROPELLER
_RUDDER = 0.5 * RHO * FIN_AREA * C_L_RUDDER  # force over flow and angle [kg/m]
_STERN = 0.5 * RHO * FIN_AREA * C_L_STERN
_TOP_SPEED = 2.5  # [m/s]: Allen et al. 2000, for the limits of the moments
# Force of rudder and stern plane over flow and angle [kg/m], at FIN_X.
_FINS: dict[Hull, tuple[float, float]] = {
    "fossen": (_RUDDER, _STERN),
    "prestero": (-prestero.FIN_MOMENT / FIN_X, -prestero.FIN_MOMENT / FIN_X),
}


class Remus100(SixDegrees):
    """A REMUS 100: commands become revolution and fin angles, which follow with their lags and within their limits.

    The state is pose (6), velocity (6), n, delta_r, delta_s, and their commands.
    """

    model: ClassVar[str] = "remus100"
    signals: ClassVar[tuple[Signal, ...]] = _SIGNALS

    limits: Vec3 = (
        _THRUST * K_T0 * (N_LIMIT / 60.0) ** 2,  # at rest
        -_STERN * FIN_X * FIN_LIMIT * _TOP_SPEED**2,
        -_RUDDER * FIN_X * FIN_LIMIT * _TOP_SPEED**2,
    )

    def __init__(self, config: PlantConfig, hull: Hull = "fossen") -> None:
        """A vehicle with mass, hull and fins by one of two sources; nothing of the run changes its equations."""
        if hull not in HULLS:
            raise ValueError(f"expected hull as one of {', '.join(HULLS)}, got {hull!r:.80}")
        self._hull: Hull = hull

    def start(self, pose: Vec6, velocity: Vec6) -> PlantState:
        """The state with fins amidships and the propeller at the revolution that keeps this speed in still water."""
        n = revolution(_drag(velocity[0]), velocity[0]) if velocity[0] > 0.0 else 0.0
        return (*pose, *velocity, n, 0.0, 0.0, n, 0.0, 0.0)

    def step(self, state: PlantState, tau: Vec3, water: Water, dt: float) -> PlantState:
        """The state after one RK4 step; the allocation is made at its beginning, from the true velocity."""
        phi, theta, psi, u, v, w, p, q, r = state[3:12]
        through = flow(rotation(phi, theta, psi), (u, v, w), (p, q, r), water.current)
        commands = allocate(tau, through.velocity, self._hull)
        return (*advance(state[:15], commands, water, dt, self._hull), *commands)

    def report(self, state: PlantState) -> Mapping[str, float]:
        """The actuators and their commands [rpm, rad], by the names in `signals`."""
        n, rudder, stern, n_cmd, rudder_cmd, stern_cmd = state[12:]
        return {
            "rpm": n,
            "rpm_cmd": n_cmd,
            "rudder": rudder,
            "rudder_cmd": rudder_cmd,
            "stern": stern,
            "stern_cmd": stern_cmd,
        }


def allocate(tau: Vec3, through: Vec3, hull: Hull = "fossen") -> Vec3:
    """The revolution and fin angles that give a force and moments in the steady state, as far as the limits allow.

    At low speed fins have no force. To keep them from moving from stop to stop, their angle decreases below 0.2 m/s
    (`SLOW_FLOW`). At rest they are amidships, whatever the command is.

    Args:
        tau: surge force [N], pitch and yaw moment [N m].
        through: velocity through the water [m/s, body].
        hull: the hull that the fins belong to.

    Returns:
        n [rpm], delta_r, delta_s [rad], within their limits.
    """
    X, M, N = tau
    u, v, w = through
    u_r = hypot(u, v, w) * u
    per_moment = u_r / (u_r * u_r + SLOW_FLOW * SLOW_FLOW) / FIN_X
    rudder, stern = _FINS[hull]
    return revolution(X, u), _fin(-N * per_moment / rudder), _fin(M * per_moment / stern)


def revolution(X: float, u: float) -> float:
    """The revolution [rpm] whose steady surge force is X [N] at the speed u [m/s], between 0 and `N_LIMIT`.

    The propeller is not reversed. It brakes by turning more slowly than the water would turn it. It brakes most at half
    of that revolution. A stronger braking force also gets half.
    """
    free = max(u, 0.0) * _FALL_T / K_T0  # n / 60 at which the propeller neither drives nor brakes
    square = 0.25 * free * free + X / (_THRUST * K_T0)
    return min(60.0 * (0.5 * free + sqrt(max(square, 0.0))), N_LIMIT) if square > 0.0 or free > 0.0 else 0.0


def _fin(angle: float) -> float:
    return max(-FIN_LIMIT, min(FIN_LIMIT, angle))


def _drag(u: float) -> float:
    """The drag [N] of the hull at the speed u [m/s] straight ahead, u >= 0."""
    return _PRESSURE * _PARASITIC * u * u + _DAMPING[0] * exp(-3.0 * u) * u


def _cross_flow(v: float, r: float) -> tuple[float, float]:
    """The integrals of |v + x r| (v + x r) and of x times it, x from stern to bow [m^3/s^2, m^4/s^2].

    Strip theory has these as sums; a hull of constant section has them in closed form. It needs to know where the flow
    across the hull changes its sign.
    """
    a = 0.5 * LENGTH
    if abs(v) >= abs(r) * a:
        sign = 1.0 if v >= 0.0 else -1.0
        return sign * 2.0 * a * (v * v + a * a * r * r / 3.0), sign * 4.0 / 3.0 * a**3 * v * r
    x0 = -v / r
    rr = r * abs(r)
    return -2.0 * rr * x0 * (a * a + x0 * x0 / 3.0), rr * (0.5 * a**4 + a * a * x0 * x0 - x0**4 / 6.0)


def advance(state: PlantState, commands: Vec3, water: Water, dt: float, hull: Hull = "fossen") -> PlantState:
    """Pose, velocity, n, delta_r and delta_s `dt` [s] later.

    Args:
        state: the present values [m, rad; m/s, rad/s; rpm, rad].
        commands: constant commands of the actuators: n [rpm], delta_r, delta_s [rad].
        water: current and disturbance.
        dt: length of the step [s].
        hull: the hull, with its mass and fins.
    """
    return rk4(lambda s: _rate(s, commands, water, hull), state, dt)


def _rate(s: PlantState, commands: Vec3, water: Water, hull: Hull) -> tuple[float, ...]:
    """The time derivative of pose, velocity, n, delta_r and delta_s."""
    _, _, _, phi, theta, psi, u, v, w, p, q, r, n, rudder, stern = s
    R = rotation(phi, theta, psi)
    (u_r, v_r, w_r), (du, dv, dw) = flow(R, (u, v, w), (p, q, r), water.current)
    nu_r = (u_r, v_r, w_r, p, q, r)
    rps = n / 60.0
    thrust = _THRUST * rps * (K_T0 * rps - _FALL_T * u_r)
    torque = _TORQUE * rps * (K_Q0 * rps - _FALL_Q * u_r)
    if hull == "fossen":
        body, (X, Y, Z, K, M, N) = BODY, _forces(nu_r, rudder, stern, thrust, torque)
    else:
        body, (X, Y, Z, K, M, N) = prestero.BODY, prestero.forces(nu_r, rudder, stern)
        X += thrust - (_drag(u_r) if u_r >= 0.0 else -_drag(-u_r))
        K += torque
    g1, g2, g3, g4, g5, g6 = body.restoring(phi, theta)
    e1, e2, e3, e4, e5, e6 = water.wrench
    a1, a2, a3, a4, a5, a6 = body.acceleration(
        (X - g1 + e1, Y - g2 + e2, Z - g3 + e3, K - g4 + e4, M - g5 + e5, N - g6 + e6)
    )
    n_cmd, rudder_cmd, stern_cmd = commands
    return (
        *to_earth(R, (u, v, w)),
        *euler_rates(phi, theta, p, q, r),
        a1 + du,
        a2 + dv,
        a3 + dw,
        a4,
        a5,
        a6,
        (n_cmd - n) / T_N,
        (rudder_cmd - rudder) / T_FIN,
        (stern_cmd - stern) / T_FIN,
    )


def _forces(nu_r: Vec6, rudder: float, stern: float, thrust: float, torque: float) -> Vec6:
    """Forces and moments [N, N m] of hull, fins, propeller and inertia."""
    u_r, v_r, w_r, p, q, r = nu_r
    lateral = hypot(v_r, w_r)
    speed = hypot(u_r, lateral)

    # Lift and drag of the hull, in the plane of its axis and the flow. sin cos of the angle of attack in place of the
    # angle: the same where it is small, and right where the vehicle falls sideways or goes astern.
    attack = atan2(lateral, u_r)
    sa, ca = sin(attack), cos(attack)
    C_L = _LIFT * sa * ca
    pressure = _PRESSURE * speed * speed
    drag = pressure * (_PARASITIC + C_L * C_L / (pi * OSWALD * _ASPECT))
    lift = pressure * C_L
    ahead = lift * sa - drag * ca
    across = -(lift * ca + drag * sa) / lateral if lateral > 0.0 else 0.0

    sway, yaw = _cross_flow(v_r, r)
    heave, pitch = _cross_flow(w_r, -q)

    u_speed = speed * u_r
    Y_fin = -_RUDDER * u_speed * rudder
    Z_fin = -_STERN * u_speed * stern
    X_fin = Y_fin * rudder + Z_fin * stern

    c1, c2, c3, c4, c5, c6 = BODY.coriolis(nu_r)
    d1, d2, d3, d4, d5, d6 = _DAMPING
    _, a22, a33, a44, a55, a66 = BODY.added
    slow = exp(-3.0 * speed)
    return (
        thrust + X_fin + ahead - slow * d1 * u_r - c1,
        Y_fin + across * v_r - _CROSS * sway - slow * d2 * v_r - c2 + a33 * w_r * p,
        Z_fin + across * w_r - _CROSS * heave - slow * d3 * w_r - c3 - a22 * v_r * p,
        torque - d4 * p - c4,
        -FIN_X * Z_fin + _CROSS * pitch - d5 * q - c5 - (a44 - a66) * r * p,
        FIN_X * Y_fin - _CROSS * yaw - d6 * r - c6 - (a55 - a44) * p * q,
    )
