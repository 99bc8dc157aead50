"""What a scenario's keys must fulfil together.

Each rule looks at a few keys and reports what does not fit. A rule that reads a key which is wrong by itself,
and so is reported already, stops there (`UnknownValueError`) and the other rules go on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from agents.profiles import profile
from fleet.errors import Problem
from fleet.graph import build, parse_edge
from fleet.quantities import RATE, SPEED, Vec3, show, show_time, show_vector
from fleet.schema import ScenarioSpec
from fleet.tuning import qp_period_ns
from fleet.yaml_marks import Mapping, locate
from netem.config import Link
from netem.grammar import GrammarError, parse_selector

_LINKS_SHOWN = 12


class UnknownValueError(Exception):
    """The value that a rule needs is itself wrong."""


@dataclass
class Report:
    """The problems found so far in one tree."""

    root: Mapping
    problems: list[Problem] = field(default_factory=list)

    def add(self, path: tuple[str | int, ...], message: str, hint: str = "", *, key: bool = False) -> None:
        """Report a mistake at the value (or the key) at `path`, or at its nearest ancestor that is there."""
        name = ".".join(str(step + 1) if isinstance(step, int) else step for step in path)
        self.problems.append(locate(self.root, path, key=key).problem(f"{name}: {message}", hint))

    def keys(self, *path: str) -> list[str]:
        """The keys of the mapping at `path`, as written."""
        node = self.root
        for step in path:
            below = node.entries.get(step)
            if not isinstance(below, Mapping):
                return []
            node = below
        return list(node.entries)


def check(spec: ScenarioSpec, report: Report) -> None:
    """Apply every rule."""
    for rule in RULES:
        try:
            rule(spec, report)
        except UnknownValueError:
            continue


def _duration(spec: ScenarioSpec, report: Report) -> None:
    _whole(report, ("duration",), spec.duration, spec.tick)


def _network_period(spec: ScenarioSpec, report: Report) -> None:
    if not spec.network.ideal:
        _whole(report, ("network", "period"), spec.network.period, spec.tick)


def _qp_period(spec: ScenarioSpec, report: Report) -> None:
    period = qp_period_ns(spec.profile, spec.guidance)
    if spec.guidance.qp_period is not None:
        _whole(report, ("guidance", "qp_period"), period, spec.tick)
    elif period % spec.tick:
        report.add(
            ("tick",),
            f"the QP period of profile {spec.profile}, {show_time(period)}, is not a whole number of ticks "
            f"of {show_time(spec.tick)}",
            "choose a tick that divides it, or set guidance.qp_period",
        )


def _whole(report: Report, path: tuple[str, ...], ns: int, tick: int) -> None:
    if ns % tick:
        below = ns // tick * tick
        near = " or ".join(show_time(t) for t in (below, below + tick) if t)
        message = f"{show_time(ns)} is not a whole number of ticks of {show_time(tick)}"
        report.add(path, message, f"nearest: {near}")


def _formation(spec: ScenarioSpec, report: Report) -> None:
    f = spec.formation
    if f.offsets is None and f.shape is None:
        report.add(("formation",), "needs offsets, one per vehicle, or a shape", key=True)
    elif f.offsets is not None and f.shape is not None:
        report.add(("formation", "shape"), "either offsets or a shape, not both", key=True)
    if f.offsets is not None and f.spacing is not None:
        report.add(("formation", "spacing"), "has no effect on offsets: it belongs to a shape", key=True)


def _offsets(spec: ScenarioSpec, report: Report) -> None:
    if spec.formation.offsets is not None:
        _one_each(report, ("formation", "offsets"), len(spec.formation.offsets), spec.vehicles)


def _initial(spec: ScenarioSpec, report: Report) -> None:
    states = spec.initial.vehicles
    if states is not None:
        _one_each(report, ("initial",), len(states), spec.vehicles)
        for index, state in enumerate(states):
            if abs(state.pitch) >= math.pi / 2:
                report.add(("initial", index, "pitch"), "must be between -90 deg and 90 deg")


def _one_each(report: Report, path: tuple[str, ...], got: int, vehicles: int) -> None:
    if got != vehicles:
        hint = "write one entry per vehicle"
        report.add(path, f"expected {vehicles} entries, one per vehicle, got {got}", hint, key=True)


def _graph_form(spec: ScenarioSpec, report: Report) -> None:
    g = spec.graph
    if g.edges is None and g.shape is None:
        report.add(("graph",), 'needs a shape, or edges such as {"1->2": 1.0}', key=True)
    elif g.edges is not None and g.shape is not None:
        report.add(("graph", "shape"), "either edges or a shape, not both", key=True)
    for key in ("ahead", "behind"):
        if g.edges is not None and getattr(g, key) is not None:
            report.add(("graph", key), "has no effect on edges: it belongs to a shape", key=True)


def _ring(spec: ScenarioSpec, report: Report) -> None:
    if spec.graph.shape == "ring" and spec.vehicles < 3:
        message = f"a ring needs 3 vehicles or more, got {spec.vehicles}"
        report.add(("graph", "shape"), message, "use path")


def _edges(spec: ScenarioSpec, report: Report) -> None:
    seen: set[Link] = set()
    for text in report.keys("graph", "edges"):
        path = ("graph", "edges", text)
        link = parse_edge(text)
        if link is None:
            report.add(path, 'expected a directed edge such as "1->2": vehicle 2 hears vehicle 1', key=True)
            continue
        if link[0] == link[1]:
            report.add(path, "a vehicle cannot hear itself", key=True)
        if link in seen:
            report.add(path, "the same edge is given twice", key=True)
        seen.add(link)
        for end in link:
            if not 1 <= end <= spec.vehicles:
                report.add(path, f"there is no vehicle {end}: they are 1 to {spec.vehicles}", key=True)


def _followers(spec: ScenarioSpec, report: Report) -> None:
    followers = spec.graph.reference
    if followers == "all":
        return
    if not followers:
        report.add(
            ("graph", "reference"),
            "no vehicle follows the reference (b_i > 0), so the formation would have no place to go",
            'write "all", or the numbers of the vehicles that do',
        )
    seen: set[int] = set()
    for index, number in enumerate(followers):
        if not 1 <= number <= spec.vehicles:
            report.add(("graph", "reference", index), f"there is no vehicle {number}: they are 1 to {spec.vehicles}")
        elif number in seen:
            report.add(("graph", "reference", index), f"vehicle {number} is given twice")
        seen.add(number)


def _links(spec: ScenarioSpec, report: Report) -> None:
    written: dict[str, str] = {}
    links = _graph_links(spec)
    known: set[tuple[int | None, int | None]] = {(None, None), *links}
    known |= {(src, None) for src, _ in links} | {(None, dst) for _, dst in links}
    for text in report.keys("network", "links"):
        path = ("network", "links", text)
        try:
            selector = parse_selector(text)
        except GrammarError:
            continue  # reported by the schema
        if str(selector) in written:
            report.add(path, f'the same links as "{written[str(selector)]}"', key=True)
        written[str(selector)] = text
        # (None, None), "*", is every link there is, even if that is none: a fleet of one keeps its scenario.
        there = (selector.src, selector.dst) in known
        if not there and not (selector.both and (selector.dst, selector.src) in known):
            shown = ", ".join(f"{src}->{dst}" for src, dst in links[:_LINKS_SHOWN])
            more = f" and {len(links) - _LINKS_SHOWN} more" if len(links) > _LINKS_SHOWN else ""
            report.add(path, "the graph has no such link", f"links: {shown}{more}", key=True)


def _graph_links(spec: ScenarioSpec) -> tuple[Link, ...]:
    g = spec.graph
    if (g.edges is None) == (g.shape is None) or any(parse_edge(text) is None for text in g.edges or ()):
        raise UnknownValueError
    return build(g, spec.vehicles).links


def _velocity_bounds(spec: ScenarioSpec, report: Report) -> None:
    """Strictly inside, the QP is feasible for every consensus error: some k > 0 exists on each axis."""
    preset = profile(spec.profile)[0]
    velocity = spec.reference.velocity
    bounds: dict[str, Vec3] = {
        "rho_lo": spec.guidance.rho_lo or preset.rho_lo,
        "rho_hi": spec.guidance.rho_hi or preset.rho_hi,
    }
    for name, bound in bounds.items():
        sign = 1.0 if name == "rho_lo" else -1.0
        for axis, limit, speed in zip("xyz", bound, velocity, strict=True):
            if sign * limit < sign * speed:
                continue
            ours = getattr(spec.guidance, name) is not None
            report.add(
                ("guidance", name) if ours else ("reference", "velocity"),
                f"{name} {show_vector(bound, SPEED)} must be {'below' if sign > 0 else 'above'} the "
                f"reference velocity {show_vector(velocity, SPEED)} on every axis; it is not on {axis}",
                "" if ours else f"the bound is that of profile {spec.profile}; set guidance.{name}",
            )
            break


def _gain_bounds(spec: ScenarioSpec, report: Report) -> None:
    preset = profile(spec.profile)[0]
    k_min = preset.k_min if spec.guidance.k_min is None else spec.guidance.k_min
    k_max = preset.k_max if spec.guidance.k_max is None else spec.guidance.k_max
    if k_min > k_max:
        name = "k_max" if spec.guidance.k_max is not None else "k_min"
        report.add(("guidance", name), f"k_min {show(k_min, RATE)} is above k_max {show(k_max, RATE)}")


def _cosine_guard(spec: ScenarioSpec, report: Report) -> None:
    if spec.tracking.cos_eps is not None and spec.tracking.cos_eps >= 1.0:
        report.add(("tracking", "cos_eps"), f"is a cosine and must be below 1, got {spec.tracking.cos_eps!r}")


RULES: tuple[Callable[[ScenarioSpec, Report], None], ...] = (
    _duration,
    _network_period,
    _qp_period,
    _formation,
    _offsets,
    _initial,
    _graph_form,
    _ring,
    _edges,
    _followers,
    _links,
    _velocity_bounds,
    _gain_bounds,
    _cosine_guard,
)
