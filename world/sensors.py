"""The navigation sensor: the vehicle's own pose and velocity, with white noise if the scenario asks for it.

| symbol | meaning | unit | frame |
|---|---|---|---|
| eta = (x, y, z, theta, psi) | position, pitch, heading | m, rad | NED |
| nu = (u, v, w, q, r) | velocity over ground, pitch and yaw rate | m/s, rad/s | body |

The noise of one component at one tick is a pure function of (seed, vehicle, tick, component), so it does not
depend on who was sensed before, or how often.
"""

from __future__ import annotations

from netem.draws import normal
from world.config import NavNoise
from world.vectors import Vec5

PURPOSE = "nav noise"


def measure(
    eta: Vec5, nu: Vec5, noise: NavNoise, seed: int, vehicle: int, tick: int, purpose: str = PURPOSE
) -> tuple[Vec5, Vec5]:
    """What the sensor of a vehicle reports at a tick: the truth itself when the noise is off.

    Args:
        eta: true x, y, z [m, NED], theta, psi [rad].
        nu: true u, v, w [m/s, body, over ground], q, r [rad/s].
        noise: standard deviations.
        seed: the run's seed.
        vehicle: its number.
        tick: the tick.
        purpose: names the noise among all that is drawn.

    Returns:
        Measured eta and nu.
    """
    if noise.off:
        return eta, nu
    p, a, s, r = noise.position_m, noise.angle_rad, noise.velocity_mps, noise.rate_radps
    # A component without noise is not drawn: hashing costs more than the rest of the tick.
    x, y, z, theta, psi, u, v, w, q, rate = (
        value + sigma * normal(seed, purpose, vehicle, tick, component) if sigma else value
        for component, (value, sigma) in enumerate(zip(eta + nu, (p, p, p, a, a, s, s, s, r, r), strict=True))
    )
    return (x, y, z, theta, psi), (u, v, w, q, rate)
