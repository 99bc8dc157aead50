"""The border of stability of the linearised fleet: the gain and the delay at which deviations from the formation stop
decaying.

| symbol | meaning | unit |
|---|---|---|
| s_i, y_i = (p_i, v_i) | deviation of vehicle i and its laws; of the position and velocity that it sends | path axes |
| F, G, C | one vehicle over one tick, `fleet.analysis.linear` | |
| K | gain of the virtual control | 1/s |
| c_i = sum_j a_ij + b_i | total weight of the consensus error | 1 |
| m, d | ticks per round, delay of a link in ticks | tick |
| z | one round | |
| P_i = (F + c_i G K C_p)^m | vehicle i over one round, its neighbours at their places | |
| S_ij(z) | what the messages of j do to s_i in one round, per y_j | |
| T(z) = -a_ij C (z - P_i)^-1 S_ij(z) | from all the y that were sent to all the y | |

At phase f of a round (f = 0 .. m - 1) agent i uses the message that j sent h = -floor((f - d) / m) rounds ago. It is
f + h m ticks old, and dead reckoning with the neighbour's velocity adds v_j times that age. Hence the sawtooth:
S_ij(z) = sum over f of (F + c_i G K C_p)^(m-1-f) G K (p_j + age v_j) z^-h, exactly, hold and delay included. A vehicle
that does not know the trajectory takes the weighted mean of the velocities that it heard for v_d, which adds
G v_j / sum_j a_ij.

With w = 1/z the function prod det(I - w P_i) det(I - T) is analytic within |w| <= 1, and its zeros there are the modes
that grow. So their number is that of the unstable eigenvalues of the P_i plus the turns of det(I - T) around 0 along
the unit circle (argument principle). Long delays cost nothing this way: they are factors z^-h. It takes 2 ms; the
eigenvalues of a long delay over fine rounds take 10 s. Delays are scanned, not bisected, because the unstable delays
begin with islands. The rules of thumb of `fleet.analysis.stability` promise a gain 1.2 times, and a delay about twice,
as large as the simulation bears.

Left out: loss, jitter, noise, disturbance, limits of the actuators, everything nonlinear. A gain that is optimised is
taken as held: in the formation e = 0, and how the gain depends on e is of second order in rho = v_d - K e. Under
`extrapolate: hold` the fleet lags behind its places, e is not 0, and that is an approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, cos, pi, sin
from typing import Any, NamedTuple

import numpy as np

from fleet.analysis.linear import (
    LOOPS,
    Array,
    Complex,
    Flight,
    Linear,
    Link,
    Member,
    NotLinear,
    VehicleRound,
    linearise,
)
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.graph import reachable
from world.vectors import Vec3

# A vehicle that counts: its round, and of each link into it the sender's number, the weight, the delay [ticks].
Row = tuple[VehicleRound, list[tuple[int, float, int]]]
Answers = dict[tuple[VehicleRound, int], Complex]  # (angle, output, output), by vehicle and delay [ticks]
MOST_VEHICLES = 20  # beyond it the computation takes seconds, and only the rules of thumb are printed
LEAST_GAIN, MOST_GAIN = 1e-3, 50.0  # 1/s, between which a border is looked for
MOST_DELAY_S = 10.0
MOST_WORK_S = 20.0  # vehicles times the longest delay of their links: 4 s of CPU, which grow faster than this
FINE = 0.002  # relative accuracy of a border
LIVE = 30.0  # rad/s: the loops of the vehicles are slower
SLOW = 0.2  # rad/s


class Mode(NamedTuple):
    """How the fleet moves at its border."""

    frequency_hz: float
    loop: str  # one of LOOPS


@dataclass(frozen=True, eq=False)
class LinearFleet:
    """The fleet at any gain, and with any delay that all links share."""

    members: tuple[Member, ...]
    m: int
    tick_s: float
    on_progress: Callable[[], None] = lambda: None  # called now and then while something is computed
    _known: dict[float, list[VehicleRound]] = field(default_factory=dict)  # by gain

    def unstable(self, gain: float, delay: int | None = None) -> int:
        """How many modes grow. `gain`: K [1/s], the largest of all vehicles and axes. `delay`: of all links [ticks], in
        place of their own.
        """
        return self._survey(gain, delay)[0]

    def mode(self, gain: float, delay: int | None = None) -> Mode:
        """The oscillation that is nearest to growing, or to decaying.

        If a vehicle grows that hears nobody, its mode is the answer: those are no zeros of det(I - T). Modes that creep
        (below SLOW) are left out. If L + B is regular, det(I - T(1)) is not 0, so none of them can be the first to
        grow.
        """
        grown = max(self._rounds(gain * (1.0 + FINE)), key=lambda kind: kind.growth)  # a little beyond the border
        if grown.unstable:
            angle, loop = grown.own_mode()
            return Mode(angle / (2.0 * pi * self.m * self.tick_s), loop)
        _, rows, angles, sizes = self._survey(gain, delay)
        first = int(np.searchsorted(angles, min(SLOW * self.m * self.tick_s, 1.0)))
        nearest = []
        for axes, size in sizes.items():
            dips = [n for n in range(first, len(angles)) if size[n] <= size[max(n - 1, first) : n + 2].min()]
            _, values, right = np.linalg.svd(_part(rows, _answers(rows, angles[dips]), axes))
            at = int(np.argmin(values[:, -1]))
            shape = np.abs(right[at, -1]).reshape(-1, self._outputs // 3, len(axes))[:, 0]
            loop = LOOPS[axes[int(np.argmax((shape**2).sum(axis=0)))]]
            nearest.append((float(values[at, -1]), float(angles[dips[at]]), loop))
        _, angle, loop = min(nearest)
        return Mode(angle / (2.0 * pi * self.m * self.tick_s), loop)

    def gain_border(self, start: float, delay: int | None = None) -> float:
        """The least gain [1/s] at which a mode grows, sought from `start`; 0: at every gain, inf: at none."""
        low = high = start
        if self.unstable(start, delay):
            while self.unstable(low := low / 1.3, delay):
                high = low
                if low < LEAST_GAIN:
                    return 0.0
        else:
            while not self.unstable(high := high * 1.3, delay):
                low = high
                if high > MOST_GAIN:
                    return float("inf")
        while high - low > FINE * low:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.unstable(middle, delay) else (middle, high)
        return 0.5 * (low + high)

    def delay_border(self, gain: float) -> int | None:
        """The shortest delay of all links [ticks] at which a mode grows; None if there is none within MOST_DELAY_S. A
        little more delay can make an unstable fleet stable again, because the ages within a round begin anew. So the
        delays are gone through, in steps that such an island does not fit into.
        """
        reckons = any(member.reckons for member in self.members)
        stable, delay = 0, 1
        while not self.unstable(gain, delay):
            if delay * self.tick_s >= MOST_DELAY_S:
                return None
            stable = delay
            # Without dead reckoning by velocities no delay is known to matter.
            step = int(0.03 * delay) if reckons else delay
            delay += max(1, min(step, self.m // 8) if reckons and self.m >= 16 else step)
        while delay - stable > 1:
            middle = (stable + delay) // 2
            stable, delay = (stable, middle) if self.unstable(gain, middle) else (middle, delay)
        return delay

    def _survey(self, gain: float, delay: int | None) -> tuple[int, list[Row], Array, dict[tuple[int, ...], Array]]:
        """How many modes grow; the links that count; angles of z on the unit circle; the logarithm of abs(det(I - T))
        there, by axes that do not mix.
        """
        self.on_progress()
        kinds = self._rounds(gain)
        alone, rows = sum(kind.unstable for kind in kinds), self._rows(kinds, delay)
        if not rows:
            return alone, [], np.zeros(0), {}
        live = min(pi, LIVE * self.m * self.tick_s)
        oldest = max([delay or 0, *(link.delay for member in self.members for link in member.links)]) / self.m + 1.0
        even = int(max(50.0, live * oldest / 0.3))
        angles = np.concatenate(
            [[0.0], np.geomspace(1e-4 * live, live / even, 30), np.linspace(2.0, even, even - 1) * (live / even)]
        )
        if live < pi:
            angles = np.concatenate([angles, np.linspace(live, pi, 20)[1:]])
        # A zero outside beside a pole inside is a whole turn between two angles that are farther apart than the two.
        poles = np.concatenate([kind.poles for kind in {id(kind): kind for kind, _ in rows}.values()])
        turned, distance = np.angle(poles), np.abs(1.0 - np.abs(poles))
        sharp = (turned > 0.0) & (turned < live) & (distance < live / even)
        close = turned[sharp, None] + distance[sharp, None] * [-1.0, 0.0, 1.0]
        angles = np.union1d(angles, np.clip(close, 0.0, pi))
        answers = _answers(rows, angles)
        groups = _groups(answers)
        # Sign (a direction in the complex plane) and logarithm of det(I - T), per part.
        found = np.array([_slogdet(_part(rows, answers, axes)) for axes in groups])
        for _ in range(40):
            turn = np.abs(np.angle(found[:, 0, 1:] * found[:, 0, :-1].conj())) > 0.6
            coarse = (turn | (np.abs(np.diff(found[:, 1].real)) > 0.7)).any(axis=0)
            # Neighbours, too: two points that mirror each other about a double zero do not see it.
            wide = coarse.copy()
            wide[1:] |= coarse[:-1]
            wide[:-1] |= coarse[1:]
            wide &= np.diff(angles) > 1e-8
            if not wide.any():
                break
            new = 0.5 * (angles[1:] + angles[:-1])[wide]
            answers = _answers(rows, new)
            more = [_slogdet(_part(rows, answers, axes)) for axes in groups]
            order = np.argsort(np.concatenate([angles, new]))
            angles = np.concatenate([angles, new])[order]
            found = np.concatenate([found, more], axis=2)[:, :, order]
        turns = float(np.angle(found[:, 0, 1:] * found[:, 0, :-1].conj()).sum()) / pi
        return alone - round(turns), rows, angles, dict(zip(groups, found[:, 1].real, strict=True))

    @property
    def _outputs(self) -> int:
        return 6 if any(member.reckons or not member.told for member in self.members) else 3

    @cached_property
    def _looped(self) -> list[int]:
        """The vehicles that hear of themselves over some chain of links. If the vehicles are sorted along the other
        links, T is triangular there, with zeros on its diagonal. So these links do not change the determinant.
        """
        hearers: dict[int, list[int]] = {}
        for i, member in enumerate(self.members):
            for link in member.links:
                hearers.setdefault(link.sender, []).append(i)
        return [i for i in range(len(self.members)) if i in reachable(hearers.get(i, ()), hearers)]

    def _rounds(self, gain: float) -> list[VehicleRound]:
        """Each vehicle's own round."""
        if gain not in self._known:
            kinds: dict[Any, VehicleRound] = {}
            rounds = self._known[gain] = []
            for m in self.members:
                key = id(m.linear), round(m.c, 9), m.b, m.reckons, m.age_cap, m.told, m.pattern.tobytes()
                if key not in kinds:
                    kinds[key] = VehicleRound(m, gain, self.m, self.tick_s, self._outputs)
                rounds.append(kinds[key])
        return self._known[gain]

    def _rows(self, kinds: Sequence[VehicleRound], delay: int | None) -> list[Row]:
        """The links between the vehicles that count."""
        place = {i: number for number, i in enumerate(self._looped)}
        return [
            (kinds[i], [
                (place[link.sender], link.weight, link.delay if delay is None else delay)
                for link in self.members[i].links if link.sender in place
            ])
            for i in place
        ]  # fmt: skip


def _answers(rows: Sequence[Row], angles: Array) -> Answers:
    """The answers to the messages of all links for z = exp(i angle)."""
    z = np.exp(1j * angles)
    every = dict.fromkeys((kind, delay) for kind, links in rows for _, _, delay in links)
    return {(kind, delay): kind.answer(z, delay) for kind, delay in every}


def _groups(answers: Answers) -> list[tuple[int, ...]]:
    each = [np.abs(answer).max(axis=0) for answer in answers.values()]
    size = np.max([one.reshape(-1, 3, len(one) // 3, 3).max(axis=(0, 2)) for one in each], axis=0)
    mixed = size + size.T > 1e-6 * max(1.0, size.max())
    if mixed[1, 0] or mixed[1, 2]:
        return [(0, 1, 2)]
    return [(0, 2), (1,)] if mixed[0, 2] else [(0,), (1,), (2,)]


def _part(rows: Sequence[Row], answers: Answers, axes: tuple[int, ...]) -> Complex:
    """I - T of some axes: (angle, vehicle and output, vehicle and output)."""
    points, outputs, _ = next(iter(answers.values())).shape
    chosen = [3 * kind + axis for kind in range(outputs // 3) for axis in axes]
    blocks = {key: answer[:, chosen][:, :, chosen] for key, answer in answers.items()}
    size, k = len(rows) * len(chosen), len(chosen)
    part: Complex = np.zeros((points, size, size), complex)
    part[:, range(size), range(size)] = 1.0
    for i, (kind, links) in enumerate(rows):
        for j, weight, delay in links:
            part[:, i * k : (i + 1) * k, j * k : (j + 1) * k] += weight * blocks[kind, delay]
    return part


def _slogdet(part: Complex) -> Any:
    """Signs and logarithms of determinants. On arm64, numpy 2.4.6 warns of a division by zero for each complex matrix
    with a real pivot; its result is right.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.linalg.slogdet(part)


def linear_fleet(
    scenario: Scenario, gains: Sequence[Vec3 | None], on_progress: Callable[[], None] = lambda: None
) -> LinearFleet:
    """The linear map of a scenario's fleet, without loss, jitter, noise, disturbance and faults. `gains`: K of each
    vehicle [1/s, NED], or anything in proportion to it; None: a law that is not ours. `on_progress`: called now and
    then while something is computed of it. Raises NotLinear if there is none; the message says why.
    """
    if scenario.vehicles > MOST_VEHICLES:
        raise NotLinear(f"the fleet has more than {MOST_VEHICLES} vehicles")
    if scenario.acoustic is not None:
        raise NotLinear("messages over an acoustic channel have no fixed age")
    longest_s = max((_delay_ticks(scenario, link) for link in scenario.graph.links), default=0) * scenario.tick_ns / 1e9
    if longest_s > (most_s := MOST_WORK_S / scenario.vehicles):
        raise NotLinear(
            f"a message takes up to {longest_s:g} s; for {scenario.vehicles} vehicles they are computed up to "
            f"{most_s:.3g} s, since the time and the memory that this takes grow with the delay"
        )
    if None in gains:
        raise NotLinear(f"vehicle {gains.index(None) + 1} runs a law that does not ship with the package")
    for i, control in enumerate(scenario.controls, start=1):
        if control.plant is not None:
            raise NotLinear(f"vehicle {i} is the plant {control.plant.name}, which has equations of its own")
    K = np.array(gains)
    if K.max() <= 0.0:
        raise NotLinear("no gain is above 0")
    velocity = scenario.reference.at(0.0).velocity
    course = atan2(velocity[1], velocity[0])
    c, s = cos(course), sin(course)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # path to NED
    known: dict[Any, Linear] = {}
    members = []
    for i, control in enumerate(scenario.controls, start=1):
        key = (control.tracking_law.name, control.tracking, control.model, control.vehicle, control.tau_max)
        if key not in known:
            known[key] = linearise(
                Flight(
                    scenario.agent_config(i), control.vehicle, scenario.tick_ns / 1e9,
                    scenario.spec.physics.substeps, velocity, scenario.spec.sea.current.mean,
                )
            )  # fmt: skip
        linear = known[key]
        links = tuple(Link(j - 1, weight, _delay_ticks(scenario, (j, i))) for j, weight in scenario.graph.neighbours(i))
        oldest = max((link.delay for link in links), default=0) + scenario.round_ticks - 1
        if control.drop_after_s and oldest * scenario.tick_ns / 1e9 > control.drop_after_s:
            raise NotLinear("neighbours.drop_after leaves neighbours out between two messages")
        age_cap = round(control.age_cap_s * 1e9 / scenario.tick_ns) if control.age_cap_s else None
        members.append(
            Member(
                linear, scenario.b[i - 1], links, control.extrapolation == "neighbour", age_cap,
                turn.T @ np.diag(K[i - 1] / K.max()) @ turn,
                scenario.agent_config(i).reference is not None,
            )
        )  # fmt: skip
    return LinearFleet(tuple(members), scenario.round_ticks, scenario.tick_ns / 1e9, on_progress)


def _delay_ticks(scenario: Scenario, link: tuple[int, int]) -> int:
    """After how many ticks at most a message can be used, without loss."""
    if scenario.ideal:
        return 0
    given = [c.delay_ns + c.jitter_ns for c in scenario.possible.get(link, ())]
    return max(1, -(-max(given, default=0) // scenario.tick_ns))
