"""The forces that give a vehicle the velocity that a program commands."""

from __future__ import annotations

from math import sin

from agents.api import Nav, Vec3
from world.vehicle_params import VehicleParams

GAIN = 1.0  # 1/s: an error of velocity falls to 1/e in a second; an assumption of ours


def velocity_demand(vehicle: VehicleParams, velocity: Vec3, nav: Nav) -> Vec3:
    """Invert the model of the vehicle (eqs. 1-2): each error of velocity decays with `GAIN`.

    Sway and heave have no actuator, and no current is known: in one, the vehicle keeps an error over ground.

    Args:
        vehicle: the model of the vehicle.
        velocity: commanded surge [m/s, body], pitch and yaw rate [rad/s, body].
        nav: the own measured state.

    Returns:
        Surge force [N], pitch and yaw moment [N m], before the actuators' limits.
    """
    m1, m2, m3, m4, m5 = vehicle.inertia
    u, v, w, q, r = nav.nu
    surge, pitch, yaw = (GAIN * (wanted - is_) for wanted, is_ in zip(velocity, (u, q, r), strict=True))
    return (
        m1 * surge + vehicle.beta_u * u - m2 * v * r + m3 * w * q,
        m4 * pitch + vehicle.beta_q * q + vehicle.beta_b * sin(nav.eta[3]) - (m3 - m1) * u * w,
        m5 * yaw + vehicle.beta_r * r - (m1 - m2) * u * v,
    )
