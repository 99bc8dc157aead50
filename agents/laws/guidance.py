"""Guidance: from the consensus error to the virtual control, with a gain optimised online or fixed (eqs. 10-23).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| e, c | consensus error and the total weight of its terms | m, 1 | NED | (8), (18) |
| K | diagonal of the virtual control gain, held between optimisations | 1/s | NED | (11) |
| rho | virtual control, the commanded velocity | m/s | NED | (11), (21) |
"""

from __future__ import annotations

from typing import ClassVar

from agents.config import AgentConfig
from agents.laws.gain_qp import NoSolution, build_qp, solve
from agents.laws.velocity_command import clip, slew, virtual_control
from agents.sample import Sample
from world.signal import Signal
from world.vectors import Vec3

HELD, SOLVED, NO_SOLUTION, REFUSED = 0, 1, 2, 3

_K = Signal("K", "1/s", "diagonal of the virtual control gain in use", 3)


class FixedGuidance:
    """rho = -K e + v_d with a constant gain and without bounds: the guidance of NBC, BC and BSMC."""

    signals: ClassVar[tuple[Signal, ...]] = (_K,)
    uses: ClassVar[frozenset[str]] = frozenset({"K0", "slew"})  # the fields of GuidanceParams that it reads

    __slots__ = ("_K", "_params", "_rho")

    def __init__(self, config: AgentConfig) -> None:
        self._params = config.guidance
        self._K = config.guidance.K0
        self._rho: Vec3 | None = None

    def step(self, sample: Sample) -> tuple[Vec3, tuple[float, ...]]:
        """Answer one sample, eq. (11). `sample`: consensus error `e` [m, NED] and desired velocity [m/s, NED]. Returns
        the virtual control rho [m/s, NED], and the values of `signals`, flat.
        """
        rho = virtual_control(sample.e, self._K, sample.desired.velocity)
        if self._params.slew > 0.0:
            previous = sample.velocity if self._rho is None else self._rho
            rho = slew(rho, previous, self._params.slew * sample.dt)
        self._rho = rho
        return rho, self._K


class OptimalGuidance:
    """The gain of rho = -K e + v_d from a QP, rho within its bounds: the guidance of NBOC and BOC. It remembers the
    last gain and the last virtual control.
    """

    signals: ClassVar[tuple[Signal, ...]] = (
        _K,
        Signal("qp_status", "1", "0 gain held, 1 solved, 2 no solution and gain held, 3 exact, PIQP differs"),
        Signal("qp_failures", "1", "optimisations since the start without a solution, or where PIQP differs"),
    )
    uses: ClassVar[frozenset[str]] = frozenset(
        {"Q", "R1", "R2", "p", "K0", "k_min", "k_max", "rho_lo", "rho_hi", "slew"}
        | {"qp_ticks", "horizon_s", "cost", "solver"}
    )

    __slots__ = ("K", "_params", "_rho", "failures")

    def __init__(self, config: AgentConfig) -> None:
        self._params = config.guidance
        self.K: Vec3 = config.guidance.K0
        self._rho: Vec3 | None = None
        self.failures = 0

    def step(self, sample: Sample) -> tuple[Vec3, tuple[float, ...]]:
        """Answer one sample, eqs. (11) and (17)-(23): rho [m/s, NED], and the values of `signals`, flat. The
        optimisation runs on global ticks divisible by `qp_ticks`. At the first sample the own velocity stands for the
        previous virtual control.
        """
        params = self._params
        e, rho_d = sample.e, sample.desired.velocity
        previous = sample.velocity if self._rho is None else self._rho
        status = HELD
        if sample.tick % params.qp_ticks == 0:
            outcome = solve(build_qp(e, sample.c, rho_d, previous, self.K, params), params.solver)
            if isinstance(outcome, NoSolution):
                # Holding the last gain is safe: the bounds below hold whatever the gain is.
                status = NO_SOLUTION
                self.failures += 1
            else:
                status = REFUSED if outcome.refused else SOLVED
                self.failures += bool(outcome.refused)
                self.K = outcome.K
        rho = clip(virtual_control(e, self.K, rho_d), params.rho_lo, params.rho_hi)
        if params.slew > 0.0:
            rho = slew(rho, previous, params.slew * sample.dt)
        self._rho = rho
        return rho, (*self.K, float(status), float(self.failures))
