"""Keep vehicles apart and out of vertical cylinders: a filter on the commanded velocity, solved as a QP.

| symbol | meaning | unit | frame |
|---|---|---|---|
| p_i, v_i | own measured position and velocity over ground | m, m/s | NED |
| p_j, v_j, A | last state heard from neighbour j, and its age | m, m/s, s | NED |
| n | unit vector to the vehicle from where the neighbour should be now, or from the axis of a cylinder | 1 | NED |
| D, R | least distance of two vehicles, radius of a cylinder | m | - |
| h | distance along n, less D or R | m | - |
| rho | commanded velocity | m/s | NED |
| b | the vehicle's heading | 1 | NED |
| a, T | gain of the barrier; longest lag of the velocity behind rho | 1/s, s | - |
| climb | greatest vertical velocity that is commanded, up or down | m/s | NED |
| margin(A) | what the neighbour can have done since it sampled | m | - |

    minimise   |rho - target|^2 / 2 + PENALTY s
    subject to n' (rho - m) + s >= -(a/2) (h - margin(A) + T n' (v_i - v_j)),  m = (v_i + v_j) / 2,  of each neighbour
               n' rho       + s >= -a (h + T n' v_i),                                               of each cylinder
               b' rho >= least ahead,   s >= 0,   |rho| <= speed on each axis, climb on the vertical one

The command of the guidance has the same limit of the vertical velocity. If the horizontal command is slower than `least
ahead`, the limit decreases in proportion. The reason: a vehicle climbs by pitching. It thereby gets a heave velocity w,
which fades slowly. If it then slows down to u, it must pitch by about w / u more.

The constraints of both vehicles of a pair sum up to n' (rho_i - rho_j) >= -a (h + T h'). With v' = (rho - v) / tau, for
each lag tau up to T, this keeps h >= 0 if h + T h' >= 0 at the start. docs/background/keep-apart.md derives it.

PIQP's last bits depend on the processor. So PIQP only says which constraints are active, and elimination in a fixed
order gives the velocity.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import cos, hypot, sin, sqrt
from typing import Any, ClassVar, NamedTuple

import numpy as np
import piqp

from agents.config import KeepApartParams
from agents.laws.velocity_command import clip, slew
from agents.sample import Sample
from world.signal import Signal
from world.vectors import ZERO, Vec3, dot, minus, move_along, scale

# The price of a unit of slack. It is larger than the multipliers of constraints that can be kept: these have no slack.
PENALTY = 1000.0
TOLERANCE = 1e-10  # PIQP's tolerance
CHANGES = 8  # changes of PIQP's active constraints, at most
ROUNDING = 1e-9  # m/s, of the closed form
DEPENDENT = 1e-7  # less than this is left of the direction of a constraint that follows from others
SLACK = 1e-6  # m/s; more than this is an infeasible problem
ASIDE = 0.5  # of the velocity that is lost along a constraint, what is added across it
SIDE = 0.1  # a relative course that passes by less than this to port, over its length, has no side: starboard then
_HESSIAN = np.diag([1.0, 1.0, 1.0, 0.0]).copy(order="F")  # the Hessian of rho and the slack; PIQP wants columns
_LINEAR = np.array([0.0, 0.0, 0.0, PENALTY])


class Seen(NamedTuple):
    """The last state heard from a neighbour, as it was sampled."""

    id: int
    position: Vec3  # m, NED
    velocity: Vec3  # over ground [m/s, NED]
    age: float  # s


class Bound(NamedTuple):
    """One constraint on the commanded velocity: n' rho >= least."""

    n: Vec3  # unit vector away from what must not be approached, NED
    least: float  # m/s
    moves: Vec3  # velocity of what must not be approached [m/s, NED]


class Filtered(NamedTuple):
    """A commanded velocity that keeps apart."""

    rho: Vec3  # m/s, NED
    active: int  # constraints that hold with equality, or not at all
    slack: float  # by how much the worst constraint is missed [m/s]


def margin(age: float, speed: float, params: KeepApartParams) -> float:
    """The extra distance [m] to a neighbour that is needed because its last state is old: `age` [s], at most
    `age_cap_s`.

    Take a neighbour with an acceleration of at most alpha and a speed of at most V, `acceleration` and `speed` of
    `params`. A time A ago it had the velocity v, of size `speed`. Its velocity now differs from v by at most eta =
    min(alpha A, |v| + V). Its place now differs from the place at constant velocity v by at most delta, the integral of
    eta. The constraint needs delta + (1/a + T) eta.
    """
    alpha, span = params.acceleration, min(age, params.age_cap_s)
    most = speed + params.speed
    ramp = min(span, most / alpha)  # how long its velocity can go on to differ more
    eta = alpha * ramp
    delta = 0.5 * eta * ramp + eta * (span - ramp)
    return delta + (1.0 / params.gain + params.lag_s) * eta


def bounds(position: Vec3, velocity: Vec3, neighbours: Iterable[Seen], params: KeepApartParams) -> list[Bound]:
    """The constraint of each neighbour heard so far, then of each cylinder, from the own position [m, NED] and velocity
    over ground [m/s, NED]. One in exactly the same place counts as south of the vehicle, so that it has a direction.
    """
    a, lag = params.gain, params.lag_s
    found = []
    for _, place, v, age in neighbours:
        span = min(age, params.age_cap_s)
        n, distance = _direction(minus(position, move_along(place, v, span)))
        h = distance - params.distance - margin(age, sqrt(dot(v, v)), params)
        moves = v if age <= params.age_cap_s else ZERO  # an old neighbour is taken to wait where the extrapolation ends
        own, its = dot(n, velocity), dot(n, moves)
        found.append(Bound(n, 0.5 * (own + its) - 0.5 * a * (h + lag * (own - its)), moves))
    for obstacle in params.obstacles:
        n, distance = _direction((position[0] - obstacle.north, position[1] - obstacle.east, 0.0))
        h = distance - obstacle.radius
        found.append(Bound(n, -a * (h + lag * dot(n, velocity)), ZERO))
    return found


def filter_velocity(rho: Vec3, found: Sequence[Bound], ahead: Bound, params: KeepApartParams) -> Filtered:
    """The commanded velocity [m/s, NED] that keeps every constraint, or misses the worst of them by as little as
    possible.

    If rho, that of the guidance, keeps all constraints, the answer is rho. Otherwise the answer is the velocity nearest
    to a target. Take the constraint that rho misses most. The vehicle must lose some velocity along its direction. The
    target is rho plus half as much velocity across it. So a vehicle turns aside instead of stopping, and two vehicles
    that meet head-on pass each other. `ahead` is the least velocity along the vehicle, since it cannot hover; if rho
    has less, that counts.
    """
    missed = [bound.least - dot(bound.n, rho) for bound in found]
    worst = max(missed, default=0.0)
    if worst <= 0.0:
        return Filtered(rho, 0, 0.0)
    first = found[missed.index(worst)]
    target = move_along(rho, _aside(first, rho), ASIDE * worst)
    widest = _widest(rho, params)
    answer = _nearest(target, found, (ahead.n, min(ahead.least, dot(ahead.n, rho))), widest)
    if answer is None:  # what PIQP cannot solve, such as the velocities of a neighbour that lies
        answer = clip(move_along(rho, first.n, worst), scale(widest, -1.0), widest)
    rest = [bound.least - dot(bound.n, answer) for bound in found]
    slack = max(rest)
    return Filtered(answer, sum(left >= -SLACK for left in rest), slack if slack > SLACK else 0.0)


def _widest(rho: Vec3, params: KeepApartParams) -> Vec3:
    x, y, z = rho
    return max(params.speed, abs(x)), max(params.speed, abs(y)), max(params.climb, abs(z))


_Row = tuple[float, float, float, float, float]  # a constraint on rho and the slack: four factors, and the least sum


def _nearest(target: Vec3, found: Sequence[Bound], ahead: tuple[Vec3, float], widest: Vec3) -> Vec3 | None:
    """The velocity [m/s, NED] nearest to `target` with the least slack; None: PIQP has no solution. Every call sets up
    its own solver, for the reason that agents/laws/guidance.py gives.
    """
    along, least = ahead
    rows: list[_Row] = [*((*bound.n, 1.0, bound.least) for bound in found), (*along, 0.0, least)]
    solver: Any = piqp.DenseSolver()
    settings = solver.settings
    settings.eps_abs = settings.eps_rel = TOLERANCE
    settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = TOLERANCE
    solver.setup(
        _HESSIAN,
        _LINEAR - np.array([*target, 0.0]),
        G=np.array([row[:4] for row in rows], order="F"),
        h_l=np.array([row[4] for row in rows]),
        x_l=np.array([*scale(widest, -1.0), 0.0]),
        x_u=np.array([*widest, np.inf]),
    )
    if solver.solve() != piqp.PIQP_SOLVED:
        return None
    result = solver.result
    x, y, z = widest
    rows += [(0.0, 0.0, 0.0, 1.0, 0.0)]  # the slack; then the limits of the velocity
    rows += [(1.0, 0.0, 0.0, 0.0, -x), (0.0, 1.0, 0.0, 0.0, -y), (0.0, 0.0, 1.0, 0.0, -z)]
    rows += [(-1.0, 0.0, 0.0, 0.0, -x), (0.0, -1.0, 0.0, 0.0, -y), (0.0, 0.0, -1.0, 0.0, -z)]
    low, high, room = result.z_bl.tolist(), result.z_bu.tolist(), result.s_bl.tolist()
    duals = [*result.z_l.tolist(), low[3], *low[:3], *high[:3]]
    slacks = [*result.s_l.tolist(), room[3], *room[:3], *result.s_bu.tolist()[:3]]
    active = [k for k, (dual, slack) in enumerate(zip(duals, slacks, strict=True)) if dual > slack]
    if (exact := _polish(target, rows, active)) is not None:
        return clip(exact, scale(widest, -1.0), widest)
    north, east, down, _ = result.x.tolist()
    return north, east, down


def _polish(target: Vec3, rows: list[_Row], active: list[int]) -> Vec3 | None:
    """The nearest velocity in closed form, from the constraints that hold with equality; None: these are no solution.

    PIQP's builds differ in the last bits, and from there a run goes another way. `active` is what PIQP found. A
    constraint that pushes the wrong way is left out, and a constraint that is missed is added, one at a time.
    """
    for _ in range(CHANGES):
        solved = _eliminate(target, rows, active)
        if solved is None:
            return None
        x, y, z, slack, *pushes = solved
        weakest = min(range(len(active)), key=pushes.__getitem__, default=None)
        if weakest is not None and pushes[weakest] < 0.0:
            active = active[:weakest] + active[weakest + 1 :]
            continue
        room = [a * x + b * y + c * z + d * slack - least for a, b, c, d, least in rows]
        worst = min((k for k in range(len(rows)) if k not in active), key=room.__getitem__, default=None)
        if worst is None or room[worst] >= -ROUNDING:
            return x, y, z
        active = sorted([*active, worst])
    return None


def _eliminate(target: Vec3, rows: list[_Row], active: list[int]) -> list[float] | None:
    """rho, the slack, and how hard each active constraint pushes: rho - target = n' pushes, and these sum up to PENALTY
    on the slack. One whose direction follows from others does not push. None: they contradict each other. (Gauss, with
    the largest pivot of a column.)
    """
    size = 4 + len(active)
    left = [[0.0] * (size + 1) for _ in range(size)]
    for axis in (0, 1, 2):
        left[axis][axis], left[axis][size] = 1.0, target[axis]
    left[3][size] = -PENALTY
    for k, number in enumerate(active, start=4):
        for axis in (0, 1, 2, 3):
            left[axis][k], left[k][axis] = -rows[number][axis], rows[number][axis]
        left[k][size] = rows[number][4]
    pivots: list[int] = []  # the column of each row
    for column in range(size):
        top = len(pivots)
        best = max(range(top, size), key=lambda r: abs(left[r][column]))
        if abs(left[best][column]) < DEPENDENT:
            continue
        left[top], left[best] = left[best], left[top]
        for below in left[top + 1 :]:
            factor = below[column] / left[top][column]
            for k in range(column, size + 1):
                below[k] -= factor * left[top][k]
        pivots.append(column)
    if any(abs(row[size]) > SLACK for row in left[len(pivots) :]):
        return None
    found = [0.0] * size
    for row, column in zip(reversed(left[: len(pivots)]), reversed(pivots), strict=True):
        rest = row[size]
        for k in range(column + 1, size):  # `sum` rounds in another way from Python 3.12 on
            rest -= row[k] * found[k]
        found[column] = rest / row[column]
    return found


def _aside(bound: Bound, rho: Vec3) -> Vec3:
    """The horizontal direction to pass in: the side where the relative course passes already, otherwise starboard."""
    x, y, _ = bound.n
    level = hypot(x, y)
    if level == 0.0:
        return ZERO  # straight above or below: no side
    starboard = (y / level, -x / level, 0.0)  # starboard of the course -n
    relative = minus(rho, bound.moves)
    port = dot(starboard, relative) < -SIDE * sqrt(dot(relative, relative))
    return scale(starboard, -1.0) if port else starboard


def _direction(away: Vec3) -> tuple[Vec3, float]:
    length = sqrt(dot(away, away))
    return (scale(away, 1.0 / length), length) if length > 0.0 else ((1.0, 0.0, 0.0), 0.0)


class KeepApart:
    """The filter of one vehicle. While it changes the command, it also limits the rate of change to `slew`, so it
    remembers its last answer. It counts the samples at which no velocity kept every constraint.
    """

    signals: ClassVar[tuple[Signal, ...]] = (
        Signal("keep_apart_active", "1", "constraints that hold with equality, or not at all"),
        Signal("keep_apart_slack", "m/s", "by how much the worst constraint is missed; 0: all are kept"),
        Signal("keep_apart_infeasible", "1", "samples with slack since the start"),
        Signal("keep_apart_change", "m/s", "commanded velocity less that of the guidance, NED", 3),
    )

    def __init__(self, params: KeepApartParams, least_ahead: float) -> None:
        """`least_ahead` is the least commanded velocity along the vehicle [m/s]."""
        self._params = params
        self._least_ahead = least_ahead
        self._answer: Vec3 | None = None  # to the sample before
        self._changes = False  # whether that was another velocity than the guidance's
        self.infeasible = 0

    def step(self, rho: Vec3, sample: Sample, neighbours: Iterable[Seen]) -> tuple[Vec3, tuple[float, ...]]:
        """The commanded velocity [m/s, NED] for that of the guidance, and the values of `signals`, flat. Of the sample
        it takes `eta` and `velocity`.
        """
        params, heading = self._params, sample.eta[4]
        ahead = Bound((cos(heading), sin(heading), 0.0), self._least_ahead, ZERO)
        found = bounds(sample.eta[:3], sample.velocity, neighbours, params)
        asked, rho = rho, self._level(rho)
        goal, active, slack = filter_velocity(rho, found, ahead, params)
        self.infeasible += slack > 0.0
        if active or self._changes:
            before = rho if self._answer is None else self._answer
            goal = self._level(slew(goal, before, params.slew * sample.dt))
        self._answer, self._changes = goal, goal != rho
        return goal, (float(active), slack, float(self.infeasible), *minus(goal, asked))

    def _level(self, rho: Vec3) -> Vec3:
        """`rho` [m/s, NED] with its vertical velocity limited, to less where it is slower than the vehicle can be."""
        north, east, down = rho
        most, slowest = self._params.climb, self._least_ahead
        level = hypot(north, east)
        if level < slowest:
            most *= level / slowest
        return north, east, max(-most, min(most, down))
