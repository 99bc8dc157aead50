"""The navigation sensor: the vehicle's own pose and velocity, with white noise if the scenario asks for it.

| symbol | meaning | unit | frame |
|---|---|---|---|
| eta = (x, y, z, theta, psi) | position, pitch, heading | m, rad | NED |
| nu = (u, v, w, q, r) | velocity over ground, pitch and yaw rate | m/s, rad/s | body |
| roll = (phi, p), or () | roll and roll rate, of a vehicle that has them | rad, rad/s | NED, body |

The noise of one component at one tick is a pure function of (seed, vehicle, tick, component), so it does not
depend on who was sensed before, or how often.
"""

from __future__ import annotations

from collections.abc import Sequence

from netem.draws import normal
from world.config import NavNoise
from world.vectors import Vec5

PURPOSE = "nav noise"
Measured = tuple[Vec5, Vec5, tuple[float, ...]]  # eta, nu, roll


def measure(true: Measured, noise: NavNoise, seed: int, vehicle: int, tick: int, purpose: str = PURPOSE) -> Measured:
    """The report of a vehicle's sensor at a tick, in the form of `true`, which it is if the noise is off: pose x, y, z
    [m, NED], theta, psi [rad]; velocity u, v, w [m/s, body, over ground], q, r [rad/s]; roll phi [rad], p [rad/s], or
    nothing. `purpose` distinguishes this noise from all other draws.
    """
    if noise.off:
        return true
    eta, nu, roll = true
    p, a, s, r = noise.position_m, noise.angle_rad, noise.velocity_mps, noise.rate_radps
    sigmas = (p, p, p, a, a, s, s, s, r, r, a, r)[: 10 + len(roll)]
    # A component without noise is not drawn: hashing costs more than the rest of the tick.
    return split(
        [
            value + sigma * normal(seed, purpose, vehicle, tick, component) if sigma else value
            for component, (value, sigma) in enumerate(zip(eta + nu + roll, sigmas, strict=True))
        ]
    )


def split(values: Sequence[float]) -> Measured:
    """Eta, nu and roll of the numbers of all three, one after the other."""
    x, y, z, theta, psi, u, v, w, q, r = values[:10]
    return (x, y, z, theta, psi), (u, v, w, q, r), tuple(values[10:])
