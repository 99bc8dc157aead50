"""A plant, which docs/guide/your-vehicle.md shows. Run it with: fleet run docs/examples/torpedo.yaml"""

from math import cos, sin

from world.api import Signal


class Torpedo:
    """The built-in model, and besides a roll that swings and a propeller that needs time."""

    signals = (Signal("thrust", "N", "of the propeller"),)
    limits = (15.0, 8.0, 8.0)

    def __init__(self, config, *, lag=0.02):
        self._lag = lag
        self._model = config.model

    def start(self, pose, velocity):
        return (*pose, *velocity, 0.0)

    def step(self, state, tau, water, dt):
        phi, theta, psi, u, v, w, p, q, r, thrust = state[3:]
        cph, sph, cth, sth, cps, sps = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
        side, down = cph * v - sph * w, sph * v + cph * w  # the roll undone
        ahead, turn = cth * u + sth * down, (sph * q + cph * r) / cth
        k, (m1, m2, m3, m5, m6) = self._model, self._model.inertia
        X, Y, Z, K, M, N = water.wrench
        rates = (
            *(cps * ahead - sps * side, sps * ahead + cps * side, cth * down - sth * u),
            *(p + sth * turn, cph * q - sph * r, turn),
            (m2 * v * r - m3 * w * q - k.beta_u * u + thrust + X) / m1,
            (-m1 * u * r - k.beta_v * v + Y) / m2,
            (m1 * u * q - k.beta_w * w + Z) / m3,
            K - p - 6.0 * sph + 0.1 * thrust,
            ((m3 - m1) * u * w - k.beta_q * q - k.beta_b * sth + tau[1] + M) / m5,
            ((m1 - m2) * u * v - k.beta_r * r + tau[2] + N) / m6,
            (tau[0] - thrust) / self._lag,
        )
        return tuple(value + dt * rate for value, rate in zip(state, rates, strict=True))

    def pose(self, state):
        return state[:6]

    def velocity(self, state):
        return state[6:12]

    def report(self, state):
        return {"thrust": state[12]}
