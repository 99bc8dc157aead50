"""The online optimisation of the virtual control gain (eqs. 17-23), built as data and then solved.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| k1, k2, k3 | diagonal of the gain K that is sought | 1/s | NED | (17) |
| e, e1 | consensus error now, and predicted one step ahead | m | NED | (18) |
| rho_d | velocity of the reference | m/s | NED | (20) |
| rho = rho_d - k e | virtual control with the gain sought | m/s | NED | (20) |
| rho0, k0 | virtual control of the previous sample, previous optimal gain | m/s, 1/s | NED | (17) |
| s = c dt | total weight c of the error times the prediction step | s | - | (18) |
| Q, R1, R2, p | weights of e1, rho, rho - rho0, K - K0 | - | NED | (17) |

    minimise   e1' Q e1 + rho' R1 rho + (rho - rho0)' R2 (rho - rho0) + p |K - K0|^2
    subject to e1 = e + s rho,   rho = rho_d - K e,   rho_lo <= rho <= rho_hi,   k_min <= k <= k_max

With rho and e1 eliminated three variables remain: 1/2 k' P k + q' k within lo <= k <= hi, P diagonal because
the weights are. "printed" is the cost above. In the "consistent" cost the neighbours and the reference move
with rho_d during the prediction, and R1 weighs rho - rho_d: e1 = e + s (rho - rho_d). The printed one pulls
rho to rest, so on an axis where the formation moves towards the error it prefers the least gain.

The bounds on rho win over k_min, never over the sign of the gain (eq. 22) or k_max. While rho_lo <= rho_d <= rho_hi
there is a gain that keeps them; else there may be none, and the last gain is held.

The problem is separable (docs/background/paper.md), so a formula gives the gain, and PIQP confirms it: PIQP's last bits
depend on the processor, and those of the formula do not. Each call gets a fresh solver, because an answer must not
depend on history.

The paper has no k_max. Without it a periodic disturbance increases the gain step by step, until the inner loop cannot
follow.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np
import piqp

from agents.config import GuidanceParams, Solver
from world.vectors import Vec3

# A bound that is only just active leaves an interior point sqrt(tolerance) away from it. Measured on random
# problems: 1e-12 misses the gain by up to 1e-4, 1e-14 by 3e-6 (and rho by 6e-11) for 11 iterations instead of
# 9; at 1e-16 rounding keeps one problem in four from ever converging.
TOLERANCE = 1e-14

# How far PIQP's gain may be from the exact one [1/s]: thirty times the 3e-6 above. It decides no value, only whether a
# sample counts as failed, and that must not depend on PIQP's last bits.
AGREES = 1e-4

# An axis whose allowed range moves rho by less than this [m/s] is settled without the solver, which needs an
# interior to walk through.
FIXED_RANGE = 1e-9

# The variables are scaled so that every problem of n free axes has this Hessian. PIQP wants columns.
_IDENTITY = tuple(np.eye(n, order="F") for n in range(4))


class GainProblem(NamedTuple):
    """minimise 1/2 k' diag(P) k + q' k subject to lo <= k <= hi, k on the axes north, east, down."""

    P: Vec3  # diagonal of the Hessian
    q: Vec3  # linear cost
    lo: Vec3  # least gain [1/s]
    hi: Vec3  # greatest gain [1/s]
    e: Vec3  # consensus error [m, NED]: what a gain is multiplied with in rho


class Solution(NamedTuple):
    """The gain that minimises a problem."""

    K: Vec3  # 1/s, diagonal on north, east, down
    iterations: int = 0  # PIQP's iterations; 0 if PIQP was not needed
    refused: str = ""  # why PIQP has no solution, or has another one; empty: it agrees


class NoSolution(NamedTuple):
    """A problem that has no solution."""

    problem: GainProblem
    reason: str  # one line for a person


def build_qp(e: Vec3, c: float, rho_d: Vec3, rho0: Vec3, K0: Vec3, params: GuidanceParams) -> GainProblem:
    """The problem of one vehicle at one sample, eqs. (17)-(22): see the table for units; `rho0` and `K0` are of the
    sample before.
    """
    s = c * params.horizon_s
    pull = 1.0 if params.cost == "printed" else 0.0
    p = params.p
    k_min = params.k_min
    k_max = params.k_max
    P: list[float] = []
    q: list[float] = []
    lo: list[float] = []
    hi: list[float] = []
    for axis in (0, 1, 2):
        ei = e[axis]
        vi = rho_d[axis]
        Q = params.Q[axis]
        R1 = params.R1[axis]
        R2 = params.R2[axis]
        P.append(2.0 * (ei * ei * (Q * s * s + R1 + R2) + p))
        q.append(-2.0 * (p * K0[axis] + ei * (Q * s * (ei + pull * s * vi) + pull * R1 * vi + R2 * (vi - rho0[axis]))))
        rho_lo, rho_hi = params.rho_lo[axis], params.rho_hi[axis]
        if ei == 0.0:
            bottom, top = 0.0, k_max if rho_lo <= vi <= rho_hi else -inf
        else:
            one, other = (vi - rho_lo) / ei, (vi - rho_hi) / ei
            bottom, top = (other, min(k_max, one)) if ei > 0.0 else (one, min(k_max, other))
        hi.append(top)
        lo.append(max(min(k_min, top), bottom, 0.0))
    return GainProblem((P[0], P[1], P[2]), (q[0], q[1], q[2]), (lo[0], lo[1], lo[2]), (hi[0], hi[1], hi[2]), e)


def solve(problem: GainProblem, solver: Solver = "piqp") -> Solution | NoSolution:
    """The gain that minimises a problem, or the reason why there is none.

    P is diagonal, so each gain is -q / P, cut to its bounds: that is the answer, to the bit, on every machine. The
    solver "piqp" also solves the problem as one, and says if that gives another gain; "exact" leaves that out.
    """
    P, q, lo, hi, e = problem
    K = [0.0, 0.0, 0.0]
    free: list[int] = []
    for axis in (0, 1, 2):
        width = hi[axis] - lo[axis]
        if width < 0.0:
            return NoSolution(problem, f"axis {axis}: no gain >= 0 keeps rho within its bounds")
        if not isfinite(P[axis] + q[axis] + width):
            return NoSolution(problem, f"axis {axis}: not a finite problem")
        if P[axis] <= 0.0:
            return NoSolution(problem, f"axis {axis}: the cost does not depend on the gain")
        if width * max(1.0, abs(e[axis])) <= FIXED_RANGE:
            K[axis] = lo[axis]
        else:
            K[axis] = min(max(-q[axis] / P[axis], lo[axis]), hi[axis])
            free.append(axis)
    if free and solver == "piqp":
        return _confirm(problem, (K[0], K[1], K[2]), free)
    return Solution((K[0], K[1], K[2]))


def _confirm(problem: GainProblem, K: Vec3, free: list[int]) -> Solution:
    """The exact gain K, and whether PIQP agrees with it. Every call sets up a new solver. The last bits of a solver
    that is updated depend on the problems before.
    """
    P, q, lo, hi, _ = problem
    # Scaled by the root of the Hessian the axes weigh the same, however far their errors differ.
    scale = [sqrt(P[axis]) for axis in free]
    pairs = list(zip(free, scale, strict=True))
    solver = _new_solver()
    solver.setup(
        _IDENTITY[len(free)],
        np.array([q[axis] / root for axis, root in pairs]),
        x_l=np.array([lo[axis] * root for axis, root in pairs]),
        x_u=np.array([hi[axis] * root for axis, root in pairs]),
    )
    status = solver.solve()
    result = solver.result
    iterations = int(result.info.iter)
    if status != piqp.PIQP_SOLVED:
        return Solution(K, iterations, f"PIQP: {status.name.removeprefix('PIQP_').lower().replace('_', ' ')}")
    for (axis, root), scaled in zip(pairs, result.x.tolist(), strict=True):
        if abs(scaled / root - K[axis]) > AGREES:
            return Solution(K, iterations, f"PIQP: {scaled / root:g} on axis {axis}, where {K[axis]:g} is optimal")
    return Solution(K, iterations)


def _new_solver() -> Any:
    solver = piqp.DenseSolver()
    settings = solver.settings
    settings.eps_abs = TOLERANCE
    settings.eps_rel = TOLERANCE
    settings.eps_duality_gap_abs = TOLERANCE
    settings.eps_duality_gap_rel = TOLERANCE
    settings.preconditioner_iter = 0  # the problem comes scaled
    return solver
