"""TheLaw: a vehicle for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

from world.api import PlantConfig, Signal, Vec3, Vec6, Water


class TheLaw:
    """A torpedo in six degrees of freedom: it rolls, and its propeller needs time."""

    # What it reports besides its motion. It lands in the log under uuv/<i>/plant, with these units.
    signals = (Signal("thrust", "N", "of the propeller, behind its lag"),)

    # The largest surge force [N], pitch moment and yaw moment [N m] that it takes as a command.
    limits = (15.0, 8.0, 8.0)

    def __init__(self, config: PlantConfig, *, lag: float = 0.02, righting: float = 6.0, torque: float = 0.05) -> None:
        # What follows the star are parameters: `plant: {name: "the_law:TheLaw", parameters: {lag: 0.3}}`.
        self._lag = lag  # of the propeller [s]; the gains of profile hardened bear some 0.04 s
        self._righting = righting  # moment that turns it upright, at sin(phi) = 1 [N m]
        self._torque = torque  # roll moment of the propeller per force [N m / N]
        # The mass, inertia and damping of `vehicle.model`, which the controllers use: here the vehicle is near to it.
        # Yours has numbers of its own; `model = "my-vehicle.toml"` on the class names what is nearest to them.
        self._model = config.model

    def start(self, pose: Vec6, velocity: Vec6) -> tuple[float, ...]:
        """The state at the beginning; the next step depends on it alone. Here: pose, velocity, thrust."""
        return (*pose, *velocity, 0.0)

    def step(self, state: tuple[float, ...], tau: Vec3, water: Water, dt: float) -> tuple[float, ...]:
        """The state `dt` later [s]. It depends on the arguments alone, so that a run can go on from its log."""
        middle = [value + 0.5 * dt * rate for value, rate in zip(state, self._rates(state, tau, water), strict=True)]
        rates = self._rates(middle, tau, water)
        return tuple(value + dt * rate for value, rate in zip(state, rates, strict=True))

    def pose(self, state: tuple[float, ...]) -> tuple[float, ...]:
        """x, y, z [m, NED], phi, theta, psi [rad]."""
        return state[:6]

    def velocity(self, state: tuple[float, ...]) -> tuple[float, ...]:
        """u, v, w [m/s, body, over ground], p, q, r [rad/s]."""
        return state[6:12]

    def report(self, state: tuple[float, ...]) -> dict[str, float]:
        """The values of `signals`."""
        return {"thrust": state[12]}

    def _rates(self, state: Sequence[float], tau: Vec3, water: Water) -> tuple[float, ...]:
        """The time derivative of the state."""
        phi, theta, psi, u, v, w, p, q, r, thrust = state[3:]
        sph, cph, sth, cth, sps, cps = sin(phi), cos(phi), sin(theta), cos(theta), sin(psi), cos(psi)
        rotation = (  # from body axes to north, east, down
            (cps * cth, cps * sth * sph - sps * cph, cps * sth * cph + sps * sph),
            (sps * cth, sps * sth * sph + cps * cph, sps * sth * cph - cps * sph),
            (-sth, cth * sph, cth * cph),
        )
        north, east, down = (a * u + b * v + c * w for a, b, c in rotation)
        turn = (sph * q + cph * r) / cth  # psi'

        # The water carries the vehicle: forces depend on the velocity through the water, (u, v, w) less the current.
        uc, vc, wc = (sum(c * row[k] for c, row in zip(water.current, rotation, strict=True)) for k in range(3))
        u, v, w = u - uc, v - vc, w - wc
        k = self._model
        m1, m2, m3, m5, m6 = k.inertia
        m4 = 0.1 * m5  # inertia in roll [kg m^2]
        X, Y, Z, K, M, N = water.wrench
        return (
            *(north, east, down),
            *(p + sth * turn, cph * q - sph * r, turn),
            (m2 * v * r - m3 * w * q - k.beta_u * u + thrust + X) / m1 + r * vc - q * wc,
            (m3 * w * p - m1 * u * r - k.beta_v * v + Y) / m2 + p * wc - r * uc,
            (m1 * u * q - m2 * v * p - k.beta_w * w + Z) / m3 + q * uc - p * vc,
            ((m2 - m3) * v * w - p - self._righting * sph * cth + self._torque * thrust + K) / m4,
            ((m3 - m1) * u * w - k.beta_q * q - k.beta_b * sth + tau[1] + M) / m5,
            ((m1 - m2) * u * v - k.beta_r * r + tau[2] + N) / m6,
            (tau[0] - thrust) / self._lag,
        )
