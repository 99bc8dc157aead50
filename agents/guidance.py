"""Guidance: from the consensus error to the virtual control, with the gain optimised online (eqs. 10-23).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| e, c | consensus error and the total weight of its terms | m, 1 | NED | (8), (18) |
| K | diagonal of the virtual control gain, held between optimisations | 1/s | NED | (11) |
| rho | virtual control after its bounds | m/s | NED | (11), (21) |
"""

from __future__ import annotations

from typing import Any

from agents.command import clip, slew, virtual_control
from agents.config import GuidanceParams
from agents.gain_qp import NoSolution, build_qp, solve
from world.vehicle import Vec3

HELD, SOLVED, NO_SOLUTION = 0, 1, 2


class OptimalGuidance:
    """The virtual control of one vehicle; remembers the last gain and the last virtual control."""

    __slots__ = ("K", "_params", "_rho_d", "_started", "failure", "failures", "qp_status", "rho")

    def __init__(self, params: GuidanceParams, reference_velocity: Vec3) -> None:
        self._params = params
        self._rho_d = reference_velocity
        self._started = False
        self.K: Vec3 = params.K0
        self.rho: Vec3 = (0.0, 0.0, 0.0)
        self.qp_status = HELD
        self.failures = 0
        self.failure: NoSolution | None = None  # the newest one, to look at; not part of the state

    def step(self, tick: int, dt: float, e: Vec3, c: float, velocity: Vec3) -> Vec3:
        """The virtual control rho [m/s, NED] at a sample.

        Args:
            tick: the optimisation runs on global ticks divisible by `qp_ticks`.
            dt: time since the previous sample [s].
            e, c: consensus error [m, NED] and its total weight.
            velocity: own velocity over ground [m/s, NED]; stands for the previous rho at the first sample.
        """
        params = self._params
        rho_d = self._rho_d
        previous = self.rho if self._started else velocity
        self._started = True
        self.qp_status = HELD
        if tick % params.qp_ticks == 0:
            outcome = solve(build_qp(e, c, rho_d, previous, self.K, params))
            if isinstance(outcome, NoSolution):
                # Holding the last gain is safe: the bounds below hold whatever the gain is.
                self.qp_status = NO_SOLUTION
                self.failures += 1
                self.failure = outcome
            else:
                self.qp_status = SOLVED
                self.K = outcome.K
        rho = clip(virtual_control(e, self.K, rho_d), params.rho_lo, params.rho_hi)
        if params.slew > 0.0:
            rho = slew(rho, previous, params.slew * dt)
        self.rho = rho
        return rho

    def state(self) -> dict[str, Any]:
        """Plain values of everything that the next sample depends on."""
        return {"K": list(self.K), "rho": list(self.rho), "started": self._started, "failures": self.failures}

    def restore(self, values: dict[str, Any]) -> None:
        k1, k2, k3 = values["K"]
        x, y, z = values["rho"]
        self.K = (k1, k2, k3)
        self.rho = (x, y, z)
        self._started = values["started"]
        self.failures = values["failures"]
