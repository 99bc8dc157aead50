"""The predictions of theory about a scenario before it runs: connectivity, eigenvalues, and the limits of the gains.

| symbol | meaning | unit | source |
|---|---|---|---|
| A = (a_ij), B = diag(b_i) | weights of the graph and of the reference | 1 | (8) |
| L + B | Laplacian plus B: the consensus error of the fleet is (L + B) times its position error | 1 | (8), Lemma 1 |
| K | largest gain of the virtual control that may occur | 1/s | (11) |
| a | passive decay of the shunting model | 1/s | (43) |
| tau | age of what is heard: one round, and the delay of the link | s | |

Two rules of thumb follow from simplified loops (docs/background/paper.md, G11 and "What a network does to it"). With
the shunting model in the surge loop K lambda_max(L + B) < a, by Routh on s^3 + a s^2 + k b s + k b K lambda. Dead
reckoning with the neighbours' velocities is a neutral loop, which needs K tau rho(A) < 1. They are necessary, not
sufficient: course and pitch loops, sampling and rounds take their share. The limits of the whole linear loop are those
of `fleet.analysis.border`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

from fleet.analysis.border import MOST_DELAY_S, LinearFleet, Mode, linear_fleet
from fleet.analysis.linear import NotLinear
from fleet.analysis.slots import describe_slack
from fleet.quantities import vehicle_names
from fleet.recorder.connectivity import Connectivity
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.acoustic import describe_noise
from fleet.scenario.sections.graph import reachable
from fleet.scenario.sections.per_vehicle import Control
from fleet.scenario.sections.turns import describe_turns, greatest_age_s
from world.vectors import Vec3

_SAME = 1e-9  # difference of two logarithms of ratios


@dataclass(frozen=True, slots=True)
class Analysis:
    """What was found."""

    components: list[list[int]]  # vehicles that are connected, links taken both ways
    unreached: list[int]  # vehicles that no chain of links connects with one that follows the reference
    eigenvalues: list[complex]  # eigenvalues of L + B, by real part
    spectral_radius_A: float
    gain_max: float | None  # 1/s; None when no vehicle of the paper's guidance is there
    settled: Vec3 | None  # largest gain per axis at which it settles [1/s, NED]; None as `gain_max`
    at_most: LinearFleet | None  # the whole loop, with gains in proportion to the largest
    at_settled: LinearFleet | None  # the fleet with the gains at which it settles
    not_linear: str  # why there is none
    warnings: list[str] = field(default_factory=list)

    @property
    def lambda_max(self) -> float:
        return max(abs(value) for value in self.eigenvalues)


def analyse(scenario: Scenario, *, linear: bool = True, on_progress: Callable[[], None] = lambda: None) -> Analysis:
    """Connectivity, eigenvalues and violated limits of a scenario. `linear`: also make the whole linear loop, which
    takes longer than the rest. `on_progress`: called now and then, also later, when a caller asks the loop for its
    limits.
    """
    A, M = matrices(scenario)
    values = sorted(eigenvalues(M).tolist(), key=lambda v: (v.real, v.imag))
    largest = [_largest_gain(control) for control in scenario.controls]
    settled = [_settled_gain(scenario, i) for i in range(1, scenario.vehicles + 1)]
    ends = [gain for gain in settled if gain is not None]
    unreached = _unreached_vehicles(scenario)
    at_most = at_settled = None
    not_linear = "not every vehicle is reached" if unreached else "" if linear else "not asked for"
    if not not_linear:
        try:
            at_most, at_settled = (
                linear_fleet(scenario, largest, on_progress),
                linear_fleet(scenario, settled, on_progress),
            )
        except NotLinear as error:
            not_linear = str(error)
    found = Analysis(
        components=_components(scenario),
        unreached=unreached,
        eigenvalues=[complex(value) for value in values],
        spectral_radius_A=float(max(abs(eigenvalues(A)))),
        gain_max=max((max(gain) for gain in largest if gain is not None), default=None),
        settled=(max(g[0] for g in ends), max(g[1] for g in ends), max(g[2] for g in ends)) if ends else None,
        at_most=at_most,
        at_settled=at_settled,
        not_linear=not_linear,
    )
    found.warnings.extend(_warnings(scenario, found))
    return found


def matrices(scenario: Scenario) -> tuple[Any, Any]:
    """A and L + B, vehicle by vehicle."""
    n = scenario.vehicles
    A = np.zeros((n, n))
    for (src, dst), weight in scenario.graph.weights.items():
        A[dst - 1, src - 1] = weight
    return A, np.diag(A.sum(axis=1) + np.array(scenario.b)) - A


def report(scenario: Scenario, found: Analysis) -> list[str]:
    n = scenario.vehicles
    followers = [i for i in range(1, n + 1) if scenario.b[i - 1] > 0.0]
    one = "s" if len(followers) == 1 else ""
    who = (
        "every vehicle follows"
        if len(followers) == n
        else f"{vehicle_names(followers)} follow{one}"
        if followers
        else "no vehicle follows"
    )
    parts = len(found.components)
    components = "; ".join(map(vehicle_names, found.components))
    connected = "connected" if parts == 1 else f"in {parts} parts: {components}"
    reach = "" if found.unreached else "; links lead from there to all other vehicles" if len(followers) < n else ""
    low, high = found.eigenvalues[0], found.eigenvalues[-1]
    moored = scenario.spec.moored  # nothing is controlled
    lines = [f"graph: {connected}; {'the vehicles are moored' if moored else f'{who} the reference{reach}'}"]
    if not moored:
        radius = f"{found.spectral_radius_A:.4g}"
        lines.append(f"eigenvalues of L+B: {_number(low)} to {_number(high)}; spectral radius of A: {radius}")
    network, acoustic = scenario.spec.network, scenario.acoustic
    if acoustic is not None:
        talking = describe_turns(network, acoustic, n, scenario.tick_ns)
        lines.append(
            f"{talking}; without loss the newest message of a neighbour is up to {oldest_s(scenario):.4g} s old"
        )
        lines.append(describe_noise(network, acoustic, scenario.plans))
        lines += describe_slack(scenario)
    if found.gain_max is not None and not moored:
        lines += [*_limits(scenario, found), *_rules_of_thumb(scenario, found)]
        lines.append("docs/background/linear-stability.md explains these limits")
    return lines


def _rules_of_thumb(scenario: Scenario, found: Analysis) -> list[str]:
    gain, rules = found.gain_max, []
    assert gain is not None
    decay = shunting_decay(scenario)
    if decay is not None:
        product = gain * found.lambda_max
        rules.append(
            f"  K lambda_max(L+B) < a: {_kept_word(product < decay)}. {gain:.4g} x {found.lambda_max:.4g} = "
            f"{product:.4g} 1/s, and a = {decay:g} 1/s"
        )
    age = oldest_s(scenario)
    reckoning = dead_reckoning(scenario, found, age)
    if age > 0.0 and reckoning is not None:
        rules.append(
            f"  K tau rho(A) < 1: {_kept_word(reckoning < 1.0)}. {gain:.4g} 1/s x {age:.4g} s x "
            f"{found.spectral_radius_A:.4g} = {reckoning:.4g}"
        )
    return ["rules of thumb, necessary but not sufficient, for the largest K:", *rules] if rules else []


def _limits(scenario: Scenario, found: Analysis) -> list[str]:
    fleet, most, settled = found.at_most, found.gain_max, found.settled
    if fleet is None or found.at_settled is None:
        return [f"limits of the linear loop: not computed, because {found.not_linear}"]
    assert most is not None
    assert settled is not None
    border = fleet.gain_border(most)
    if border == 0.0:
        return ["the linear loop is unstable at every gain"]
    optimised = _is_optimised(scenario)
    own = f"Here K is optimised, {most:.4g} 1/s at most" if optimised else f"Here K is {most:.4g} 1/s"
    if border == inf:
        gain = f"stable at every gain. {own}"
    else:
        verdict = ": stable" if most < border else ": unstable if it stays so large" if optimised else ": UNSTABLE"
        gain = f"stable below {border:.4g} 1/s. Above, {_mode(fleet.mode(border))}. {own}{verdict}"
    if scenario.ideal or not scenario.graph.links:
        return ["theory of the linear loop, without loss:", f"  gain, the same on all axes: {gain}"]
    lines = [
        f"theory of the linear loop, without loss, with rounds of {scenario.round_ticks * fleet.tick_s:g} s:",
        f"  gain, the same on all axes: {gain}",
    ]
    if optimised:
        limit = _delay_limit(found.at_settled, max(settled))
        lines.append(f"  delay of every link, when K has settled at {_vector(settled)}: {limit}")
    where = "while K is at its largest," if optimised else "at K ="
    lines.append(f"  delay of every link, {where} {most:.4g} 1/s: {_delay_limit(fleet, most)}")
    lines.append(f"  the longest delay here: {_longest_delay_ns(scenario) / 1e9:.4g} s")
    return lines


def _delay_limit(fleet: LinearFleet, gain: float) -> str:
    border = fleet.delay_border(gain)
    if border is None:
        return f"stable up to {MOST_DELAY_S:g} s at least"
    if border == 1:
        return "unstable, even without delay"
    return f"stable up to {(border - 1) * fleet.tick_s:.4g} s. Above, {_mode(fleet.mode(gain, border))}"


def _kept_word(holds: bool) -> str:
    return "kept" if holds else "BROKEN"


def _mode(mode: Mode) -> str:
    if mode.frequency_hz < 0.005:
        return f"the {mode.loop} loop grows"
    return f"the {mode.loop} loop oscillates at {mode.frequency_hz:.2g} Hz and grows"


def oldest_s(scenario: Scenario) -> float:
    """The largest age of a received message without loss [s]: a round plus the longest delay, in whole ticks."""
    if scenario.ideal or not scenario.graph.links:
        return 0.0
    tick, worst = scenario.tick_ns, _longest_delay_ns(scenario)
    if scenario.acoustic is not None:
        age = greatest_age_s(scenario.spec.network, scenario.acoustic, scenario.plans, tick)
        return age + worst / 1e9
    usable = max(1, -(-worst // tick))
    return (usable + scenario.round_ticks - 1) * tick / 1e9


def _longest_delay_ns(scenario: Scenario) -> int:
    return max((c.delay_ns + c.jitter_ns for its in scenario.possible.values() for c in its), default=0)


def dead_reckoning(scenario: Scenario, found: Analysis, age_s: float) -> float | None:
    """K tau rho(A) at an age; None where no vehicle extrapolates with the velocities that neighbours sent."""
    if found.gain_max is None or not any(control.extrapolation == "neighbour" for control in scenario.controls):
        return None
    return found.gain_max * age_s * found.spectral_radius_A


def _largest_gain(control: Control) -> Vec3 | None:
    """The largest gains K [1/s, NED] that can occur; None for a law that is not ours."""
    if not control.cascade:
        return None
    match control.guidance_law.name:
        case "optimal":
            return (control.guidance.k_max,) * 3
        case "fixed":
            return control.guidance.K0
        case _:
            return None


def _settled_gain(scenario: Scenario, i: int) -> Vec3 | None:
    """Where the gains of vehicle i tend when its error decays [1/s, NED]; a fixed gain is where it is.

    That is Q s / (R1 + Q s^2), s = c times the prediction step, within its bounds; under the printed cost the least
    gain on an axis along which the formation moves (docs/background/paper.md, G10).
    """
    control = scenario.controls[i - 1]
    largest = _largest_gain(control)
    if largest is None or control.guidance_law.name != "optimal":
        return largest
    guidance = control.guidance
    s = guidance.horizon_s * (scenario.b[i - 1] + sum(weight for _, weight in scenario.graph.neighbours(i)))
    gains = []
    for Q, R1, v in zip(guidance.Q, guidance.R1, scenario.reference.at(0.0).velocity, strict=True):
        pulled = guidance.cost == "printed" and abs(v) > 1e-9
        optimum = 0.0 if pulled or Q * s == 0.0 else Q * s / (R1 + Q * s * s)
        gains.append(min(max(optimum, guidance.k_min), guidance.k_max))
    return gains[0], gains[1], gains[2]


def _is_optimised(scenario: Scenario) -> bool:
    return any(control.guidance_law.name == "optimal" for control in scenario.controls)


def _vector(values: Vec3) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ") 1/s"


def shunting_decay(scenario: Scenario) -> float | None:
    """The least a [1/s] of the vehicles with the shunting model; None: there is none."""
    decays = [c.tracking.a for c in scenario.controls if c.cascade and c.tracking_law.name == "neurodynamic"]
    return min(decays) if decays else None


def _warnings(scenario: Scenario, found: Analysis) -> Iterator[str]:
    if found.unreached:
        yield (
            f"no chain of links leads from a vehicle that follows the reference (b_i > 0) to "
            f"{vehicle_names(found.unreached)}. L+B is singular, so these have no defined place in the formation. Add "
            "links, or vehicles to graph.reference"
        )
    if loop := _loop_warning(scenario, found):
        yield loop
    else:
        yield from _rule_warnings(scenario, found)
    unstable = []
    for i, control in enumerate(scenario.controls, start=1):
        m1, m2, m3, *_ = control.vehicle.inertia
        if control.plant is None and control.cascade and not (m1 < m2 and m1 < m3):
            unstable.append(i)
    if unstable:
        yield (
            f"{vehicle_names(unstable)}: the surge inertia m1 is not below m2 and m3, so the attack and sideslip "
            "angles are unstable under the paper's tracking laws (docs/background/paper.md, G28)"
        )
    spec = scenario.spec
    late = [section.id or f"f{n}" for n, section in enumerate(spec.faults, start=1) if section.at >= spec.duration]
    if late:
        yield f"fault {', '.join(late)}: the run is over before it begins"
    connectivity = Connectivity.from_scenario(scenario)
    if connectivity is not None and connectivity.trivial:
        yield "checks.connected always holds: its vehicles follow the reference themselves (graph.reference)"


def _loop_warning(scenario: Scenario, found: Analysis) -> str:
    fleet = found.at_settled
    if fleet is None or found.settled is None or not fleet.unstable(gain := max(found.settled)):
        return ""
    border = fleet.gain_border(gain)
    if border == 0.0:
        return "the linear loop is unstable at every gain: the formation is not kept"
    what = f"K settles at {_vector(found.settled)}" if _is_optimised(scenario) else f"K is {gain:.4g} 1/s"
    limit = f"{border:.4g} 1/s" + (" for its largest axis" if len({*found.settled}) > 1 else "")
    return (
        f"{what}, above the limit of the linear loop. With these rounds and delays the limit is {limit}. "
        f"Above it {_mode(fleet.mode(border))}, and the formation is not kept. Lower the gain, or shorten rounds "
        "or delays"
    )


def _rule_warnings(scenario: Scenario, found: Analysis) -> Iterator[str]:
    decay, age = shunting_decay(scenario), oldest_s(scenario)
    if decay is not None and found.gain_max is not None and not found.gain_max * found.lambda_max < decay:
        yield (
            f"K lambda_max(L+B) = {found.gain_max * found.lambda_max:.4g} 1/s is not below a = {decay:g} 1/s, so the "
            f"surge loop of the neurodynamic law can burst. Set guidance.k_max below {decay / found.lambda_max:.4g} "
            "1/s; the true limit may be lower"
        )
    product = dead_reckoning(scenario, found, age)
    if product is not None and not product < 1.0:
        yield (
            f"K tau rho(A) = {product:.4g} is not below 1 at an age of {age:.4g} s, so extrapolation with the "
            f"neighbours' velocities is unstable. Use neighbours.extrapolate: reference, or set guidance.k_max below "
            f"{1.0 / (age * found.spectral_radius_A):.4g} 1/s; the true limit may be lower"
        )


def _components(scenario: Scenario) -> list[list[int]]:
    part_of = {i: {i} for i in range(1, scenario.vehicles + 1)}
    for one, other in scenario.graph.links:
        small, large = sorted((part_of[one], part_of[other]), key=len)
        if small is not large:
            large |= small
            part_of.update(dict.fromkeys(small, large))
    return sorted({min(part): sorted(part) for part in part_of.values()}.values())


def _unreached_vehicles(scenario: Scenario) -> list[int]:
    vehicles = range(1, scenario.vehicles + 1)
    hearers: dict[int, list[int]] = {}
    for src, dst in scenario.graph.links:
        hearers.setdefault(src, []).append(dst)
    told = reachable((i for i in vehicles if scenario.b[i - 1] > 0.0), hearers)
    return [i for i in vehicles if i not in told]


def _number(value: complex) -> str:
    return f"{value.real:.4g}" if abs(value.imag) < 1e-9 else f"{value.real:.4g}{value.imag:+.3g}i"


def eigenvalues(M: Any) -> Any:
    """The eigenvalues of a real matrix (n, n) as an array (n,), real if `M` is a symmetric matrix in other units.

    A graph has such a matrix if its links go both ways and the weights around each cycle are equal in both directions.
    The general method is slow (1,000 vehicles: 4 s instead of 0.2 s), and adds small imaginary parts for a long chain.
    """
    symmetric = _symmetric(M)
    return np.linalg.eigvals(M) if symmetric is None else np.linalg.eigvalsh(symmetric)


def _symmetric(M: Any) -> Any | None:
    linked = M != 0.0
    products = M * M.T
    if (linked & (products <= 0.0)).any():
        return None
    ratio = np.zeros(M.shape)
    ratio[linked] = 0.5 * np.log(np.abs(M[linked] / M.T[linked]))  # log(d_j / d_i)
    log_d = np.full(len(M), np.nan)
    for start in range(len(M)):
        if not np.isnan(log_d[start]):
            continue
        log_d[start] = 0.0
        front = [start]
        while front:
            i = front.pop()
            new = np.flatnonzero(linked[i] & np.isnan(log_d))
            log_d[new] = log_d[i] + ratio[i, new]
            front.extend(new.tolist())
    if (np.abs(ratio - (log_d[None, :] - log_d[:, None]))[linked] > _SAME * len(M)).any():
        return None
    return np.sign(M) * np.sqrt(products)
