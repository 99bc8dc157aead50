"""Plants of a user, as tests bring them: one that rolls, and ones that fail in a way and at a step of their own."""

from __future__ import annotations

from math import cos, nan, sin
from typing import Any, ClassVar

from world.api import PlantConfig, Signal, Vec3, Vec6, Water


class Rolling:
    """The 5-DOF model's numbers, without coupling, and a roll that swings; Euler steps."""

    signals = (Signal("thrust", "N", "behind its lag"), Signal("fins", "rad", "of both fins", 2))
    limits = (20.0, 20.0, 20.0)

    def __init__(self, config: PlantConfig, *, lag: float = 0.02) -> None:
        self._lag, self._model = lag, config.model

    def start(self, pose: Vec6, velocity: Vec6) -> tuple[float, ...]:
        return (*pose, *velocity, 0.0)

    def step(self, state: tuple[float, ...], tau: Vec3, water: Water, dt: float) -> tuple[float, ...]:
        phi, theta, psi, u, v, w, p, q, r, thrust = state[3:]
        k, (m1, m2, m3, m5, m6) = self._model, self._model.inertia
        X, Y, Z, K, M, N = water.wrench
        cx, cy, cz = water.current
        cp, sp, ct, st, ch, sh = cos(psi), sin(psi), cos(theta), sin(theta), cos(phi), sin(phi)
        side, down = ch * v - sh * w, sh * v + ch * w
        turn = (sh * q + ch * r) / ct
        rates = (
            cp * ct * u - sp * side + cp * st * down + cx,
            sp * ct * u + cp * side + sp * st * down + cy,
            ct * down - st * u + cz,
            p + st * turn,
            ch * q - sh * r,
            turn,
            (m2 * v * r - m3 * w * q - k.beta_u * u + thrust + X) / m1,
            (-m1 * u * r - k.beta_v * v + Y) / m2,
            (m1 * u * q - k.beta_w * w + Z) / m3,
            K + 0.05 * thrust - 4.0 * sh - 0.5 * p,
            ((m3 - m1) * u * w - k.beta_q * q - k.beta_b * st + tau[1] + M) / m5,
            ((m1 - m2) * u * v - k.beta_r * r + tau[2] + N) / m6,
            (tau[0] - thrust) / self._lag,
        )
        return tuple(a + dt * b for a, b in zip(state, rates, strict=True))

    def pose(self, state: tuple[float, ...]) -> tuple[float, ...]:
        return state[:6]

    def velocity(self, state: tuple[float, ...]) -> tuple[float, ...]:
        return state[6:12]

    def report(self, state: tuple[float, ...]) -> dict[str, Any]:
        return {"thrust": state[12], "fins": (state[10], state[11])}


class Failing(Rolling):
    """Fails from tick `at` on (a tick is two steps)."""

    def __init__(self, config: PlantConfig, *, how: str, at: int = 0) -> None:
        super().__init__(config)
        self._how, self._left = how, 2 * at

    def step(self, state: tuple[float, ...], tau: Vec3, water: Water, dt: float) -> tuple[float, ...]:
        self._left -= 1
        if self._left >= 0:
            return super().step(state, tau, water, dt)
        match self._how:
            case "raise":
                raise ZeroDivisionError("no water")
            case "nan":
                return (nan, *state[1:])
            case "short":
                return state[1:]
            case "text":
                return "forward"
            case "loop":
                while True:
                    pass
        return super().step(state, tau, water, dt)

    def pose(self, state: tuple[float, ...]) -> tuple[float, ...]:
        return state[:5] if self._how == "pose" and self._left < 0 else state[:6]

    def report(self, state: tuple[float, ...]) -> dict[str, Any]:
        return {"thrust": 0.0} if self._how == "report" and self._left < 0 else super().report(state)


class Elsewhere(Rolling):
    """Begins at another place than it is told."""

    def start(self, pose: Vec6, velocity: Vec6) -> tuple[float, ...]:
        return super().start((pose[0] + 1.0, *pose[1:]), velocity)


class Counting(Rolling):
    """Remembers something that is not in its state: how many steps it has made, which its thrust depends on."""

    def __init__(self, config: PlantConfig) -> None:
        super().__init__(config)
        self._steps = 0

    def step(self, state: tuple[float, ...], tau: Vec3, water: Water, dt: float) -> tuple[float, ...]:
        self._steps += 1
        return super().step(state, (tau[0] * (1.0 + 1e-4 * (self._steps % 100)), *tau[1:]), water, dt)

    def state(self) -> dict[str, int]:
        return {"steps": self._steps}

    def restore(self, values: dict[str, int]) -> None:
        self._steps = values["steps"]


class Clinging(Rolling):
    """Cannot be ended."""

    def close(self) -> None:
        raise RuntimeError("it holds on")


class RaisingLimits(Rolling):
    """Computes its limits, and cannot."""

    @property
    def limits(self) -> Vec3:
        raise LookupError("no data sheet")


class Weak(Rolling):
    """Takes less than the scenario allows."""

    limits: ClassVar[Vec3] = (2.0, 0.5, 0.5)


class NoLimits(Rolling):
    """Says nothing that is a limit."""

    limits = (20.0, -1.0, 20.0)


class Lacking:
    """Has no pose."""

    limits = (1.0, 1.0, 1.0)

    def __init__(self, config: PlantConfig) -> None:
        pass

    def start(self, pose: Vec6, velocity: Vec6) -> tuple[float, ...]:
        return (*pose, *velocity)

    def step(self, state: tuple[float, ...], tau: Vec3, water: Water, dt: float) -> tuple[float, ...]:
        return state

    def velocity(self, state: tuple[float, ...]) -> tuple[float, ...]:
        return state[6:]
