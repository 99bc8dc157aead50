"""References and changing offsets: laws of motion, and what agents make of them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import msgpack
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from loops import agent_config

from agents.codecs import FullCodec
from agents.config import AgentConfig, Neighbour
from agents.neighbours import NeighbourTable
from agents.offset import Offset, OffsetChange
from agents.payload import StateMessage, encode
from agents.trajectory import Circle, Path, PathError, Reference, StraightLine
from netem.wire.messages import Delivery
from world.vectors import minus, plus

coordinate = st.floats(-200.0, 200.0)
points = st.tuples(coordinate, coordinate, st.floats(0.0, 50.0))


@st.composite
def references(draw: st.DrawFn) -> Reference:
    """A line, a circle or helix, or a path through random points."""
    kind = draw(st.sampled_from(["line", "circle", "path"]))
    speed = draw(st.floats(0.1, 3.0))
    if kind == "line":
        return StraightLine(draw(points), (speed, draw(st.floats(-1.0, 1.0)), 0.0))
    if kind == "circle":
        sense, sink = draw(st.sampled_from([-1.0, 1.0])), draw(st.floats(-0.3, 0.3))
        return Circle(draw(points), draw(st.floats(1.0, 100.0)), speed, draw(st.floats(-7.0, 7.0)), sense, sink)
    corners = draw(st.lists(points, min_size=3, max_size=6))
    path = Path(tuple(corners), speed, draw(st.floats(0.5, 10.0)), draw(st.booleans()))
    try:
        assume(path.length > 0.0)
    except PathError:
        assume(False)
    return path


offsets = st.builds(
    lambda start, ends, times, blends: Offset(
        start, tuple(OffsetChange(sum(times[: n + 1]) + sum(blends[:n]), blends[n], end) for n, end in enumerate(ends))
    ),
    points,
    st.lists(points, max_size=3),
    st.lists(st.floats(0.0, 20.0), min_size=3, max_size=3),
    st.lists(st.floats(1.0, 20.0), min_size=3, max_size=3),
)


def table_of(delta: Offset, extrapolation: Any, reference: Reference, own: Offset) -> NeighbourTable:
    """What a vehicle at `own` knows of its neighbour 2."""
    neighbours = (Neighbour(2, 1.0, delta),)
    config = replace(agent_config(1), neighbours=neighbours, reference=reference, offset=own)
    return NeighbourTable(replace(config, extrapolation=extrapolation), FullCodec())


@given(references(), st.floats(0.0, 500.0))
def test_velocity_is_the_derivative_and_acceleration_is_bounded(reference: Reference, t: float) -> None:
    """Assumption 2: position, velocity and acceleration are bounded, position and velocity continuous."""
    h = 1e-4
    before, now, after = (reference.at(t + k * h) for k in (-1, 0, 1))
    a = reference.acceleration
    for axis in range(3):
        derivative = (after.position[axis] - before.position[axis]) / (2.0 * h)
        assert derivative == pytest.approx(now.velocity[axis], abs=1e-6 + 2.0 * a * h)
        assert abs(after.velocity[axis] - now.velocity[axis]) <= a * h * 1.001 + 1e-9


@given(references(), st.floats(0.0, 500.0))
def test_velocity_stays_within_its_bounds(reference: Reference, t: float) -> None:
    """The QP's bounds are checked against these; sampled to a degree, so to 0.02 % of the speed."""
    low, high = reference.velocity_bounds()
    for least, value, most in zip(low, reference.at(t).velocity, high, strict=True):
        slack = 2e-4 * getattr(reference, "speed", 1.0) + 1e-12
        assert least - slack <= value <= most + slack


@given(references(), st.floats(0.0, 500.0))
def test_speed_along_a_path_is_constant(reference: Reference, t: float) -> None:
    if isinstance(reference, Path):
        assert math.hypot(*reference.at(t).velocity) == pytest.approx(reference.speed)
    if isinstance(reference, Circle):
        assert math.hypot(*reference.at(t).velocity[:2]) == pytest.approx(reference.speed)
        x, y, _ = minus(reference.at(t).position, reference.center)
        assert math.hypot(x, y) == pytest.approx(reference.radius)


@given(references(), st.floats(0.0, 200.0), st.floats(0.0, 50.0))
def test_displacement_is_the_way_between(reference: Reference, begin: float, span: float) -> None:
    way = minus(reference.at(begin + span).position, reference.at(begin).position)
    assert reference.displacement(begin, span) == pytest.approx(way, abs=1e-9)


@given(references(), st.floats(0.0, 200.0), st.floats(0.0, 50.0))
def test_no_chord_is_longer_than_the_way(reference: Reference, begin: float, span: float) -> None:
    """No jump anywhere, also where a piece of a path or a lap ends: nothing gets further than its speed allows."""
    speed = math.hypot(*reference.at(begin).velocity)  # constant on every reference
    assert math.hypot(*reference.displacement(begin, span)) <= speed * span + 1e-9


@st.composite
def roomy_paths(draw: st.DrawFn) -> Path:
    """Paths with a straight piece on every leg, open or closed."""
    corners = draw(st.lists(points, min_size=3, max_size=5))
    path = Path(tuple(corners), draw(st.floats(0.1, 3.0)), draw(st.floats(2.0, 10.0)), draw(st.booleans()))
    try:
        tightest = replace(path, radius=1.1 * path.radius)  # fits too, so that 10 % of each arc's share are left over
        assume(tightest.length > 0.0)
    except PathError:
        assume(False)
    return path


@given(roomy_paths())
def test_a_path_is_made_of_its_legs_and_arcs(path: Path) -> None:
    """Of each leg an arc takes radius tan(turn / 2) at its end; the middle of what is left is passed on the leg, in
    its direction, after the way that the legs and arcs before it have."""
    ends = [*path.points, path.points[0]] if path.closed else list(path.points)
    legs = [(a, b, math.dist(a, b)) for a, b in pairwise(ends)]
    turns = []
    for (a, b, this), (_, c, following) in zip(legs, [*legs[1:], legs[0]], strict=True):
        cosine = sum(p * q for p, q in zip(minus(b, a), minus(c, b), strict=True)) / (this * following)
        turns.append(math.acos(max(-1.0, min(1.0, cosine))))
    if not path.closed:
        turns[-1] = 0.0
    way = 0.0
    for n, (a, b, length) in enumerate(legs):
        before, after = (path.radius * math.tan(turns[k] / 2) for k in (n - 1, n))
        straight = length - before - after
        share = (before + straight / 2) / length
        middle = tuple(p + share * q for p, q in zip(a, minus(b, a), strict=True))
        now = path.at((way + straight / 2) / path.speed)
        assert now.position == pytest.approx(middle, abs=1e-4)  # 1e-4: of the arc cosine above
        ahead = tuple(q / length * path.speed for q in minus(b, a))
        assert now.velocity == pytest.approx(ahead, abs=1e-4)
        way += straight + path.radius * turns[n]
    assert path.length == pytest.approx(way, abs=1e-4)


@given(roomy_paths(), st.floats(0.0, 300.0), st.integers(1, 5))
def test_a_closed_path_comes_round(path: Path, t: float, laps: int) -> None:
    """However often, with the velocity that it had."""
    path = replace(path, closed=True)
    try:
        lap = path.length / path.speed
    except PathError:
        assume(False)
    again, now = path.at(t + laps * lap), path.at(t)
    assert again.position == pytest.approx(now.position, abs=1e-6)
    assert again.velocity == pytest.approx(now.velocity, abs=1e-6)


@given(points, st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.lists(st.floats(1.0, 50.0), min_size=2, max_size=5))
@example((7.0, -17.0, 10.0), (-0.1, 0.7, 0.7), [10.0, 15.0])
def test_points_on_one_line_need_no_arc(start: Any, ahead: Any, steps: list[float]) -> None:
    """However their coordinates are rounded. An arc of 1e-8 rad between them once had no direction to turn to."""
    assume(math.hypot(*ahead) > 0.1)
    ways = [sum(steps[:n]) for n in range(len(steps) + 1)]
    path = Path(tuple(tuple(p + way * d for p, d in zip(start, ahead, strict=True)) for way in ways), 0.5, 10.0)
    assert path.acceleration == 0.0
    assert path.length == pytest.approx(ways[-1] * math.hypot(*ahead))


@given(references().filter(lambda reference: not isinstance(reference, Path)) | roomy_paths())
def test_velocity_bounds_are_tight(reference: Reference) -> None:
    """To a percent: wider ones would refuse scenarios that can be flown. Sampled to 0.02 rad of a turn."""
    low, high = reference.velocity_bounds()
    if isinstance(reference, StraightLine):
        assert low == high == reference.velocity
        return
    length = reference.length if isinstance(reference, Path) else 2.0 * math.pi * reference.radius
    steps = math.ceil(length / (0.02 * reference.radius))
    velocities = [reference.at(length / reference.speed * n / steps).velocity for n in range(steps + 1)]
    for axis in range(3):
        seen = [velocity[axis] for velocity in velocities]
        assert min(seen) - low[axis] <= 0.01 * reference.speed + 1e-12
        assert high[axis] - max(seen) <= 0.01 * reference.speed + 1e-12


def test_an_open_path_goes_on() -> None:
    path = Path(((0.0, 0.0, 5.0), (50.0, 0.0, 5.0), (50.0, 40.0, 5.0)), 0.5, 4.0)
    assert path.at(0.0).position == (0.0, 0.0, 5.0)
    end = path.length / path.speed
    assert path.at(end).position == pytest.approx((50.0, 40.0, 5.0))
    assert path.at(end + 10.0).position == pytest.approx((50.0, 45.0, 5.0))
    # The corner is cut: radius (sqrt(2) - 1) away from it.
    nearest = min(math.dist(path.at(k * 0.1).position, (50.0, 0.0, 5.0)) for k in range(2000))
    assert nearest == pytest.approx(4.0 * (math.sqrt(2.0) - 1.0), abs=1e-3)


@pytest.mark.parametrize(
    ("corners", "closed", "leg", "words"),
    [
        (((0.0, 0.0, 0.0),), False, 0, "needs 2 points or more"),
        (((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)), True, 0, "needs 3 points or more"),
        (((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (9.0, 0.0, 0.0)), False, 2, "the same"),
        (((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 0.0, 0.0)), False, 1, "turns back on itself"),
        (((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (9.0, 3.0, 0.0), (0.0, 3.0, 0.0)), False, 2, "is 3 m long"),
    ],
)
def test_what_no_arc_can_follow(corners: Any, closed: bool, leg: int, words: str) -> None:
    with pytest.raises(PathError, match=words) as caught:
        Path(corners, 0.5, 2.0, closed).at(0.0)
    assert caught.value.leg == leg


@given(offsets, st.floats(0.0, 100.0))
def test_a_blend_is_smooth(offset: Offset, t: float) -> None:
    """The rate is the derivative, bounded by 1.875 of an even pace, and zero where nothing changes; it changes no
    faster than 10 x^3 - 15 x^4 + 6 x^5 does, whose second derivative is at most 10 / sqrt(3)."""
    h = 1e-5
    now, after = offset.at(t), offset.at(t + h)
    places = [offset.start, *(change.offset for change in offset.changes)]
    pace = max(
        (math.dist(a, b) / c.blend for a, b, c in zip(places, places[1:], offset.changes, strict=False)), default=0.0
    )
    assert math.hypot(*now.velocity) <= 1.875 * pace + 1e-9
    bend = max(
        (math.dist(a, b) / c.blend**2 for a, b, c in zip(places, places[1:], offset.changes, strict=False)), default=0.0
    )
    assert math.dist(now.velocity, after.velocity) <= 10.0 / math.sqrt(3.0) * bend * h * 1.001 + 1e-9
    for axis in range(3):
        derivative = (after.position[axis] - now.position[axis]) / h
        assert derivative == pytest.approx(now.velocity[axis], abs=1e-4 + 20.0 * pace * h)
    if offset.changes and t > offset.changes[-1].begin + offset.changes[-1].blend:
        assert now == (offset.changes[-1].offset, (0.0, 0.0, 0.0))


@given(references(), offsets, offsets)
def test_configuration_travels(reference: Reference, own: Offset, other: Offset) -> None:
    """to_values is plain MessagePack, from_values its inverse."""
    config = replace(agent_config(1), reference=reference, offset=own, neighbours=(Neighbour(2, 0.8, other),))
    again = AgentConfig.from_values(msgpack.unpackb(msgpack.packb(config.to_values())))
    assert again == config
    assert again.desired(12.3) == config.desired(12.3)


@given(references(), st.data())
def test_reference_extrapolation_is_exact_in_formation(reference: Reference, data: st.DataObject) -> None:
    """A neighbour that is exactly where it should be is known exactly, however old the news is: also in a turn, and
    while the formation changes."""
    own = data.draw(offsets)
    others = Offset(data.draw(points), tuple(replace(c, offset=data.draw(points)) for c in own.changes))
    delta = Offset(
        minus(own.start, others.start),
        tuple(replace(c, offset=minus(c.offset, d.offset)) for c, d in zip(own.changes, others.changes, strict=True)),
    )
    sent, age = data.draw(st.integers(0, 5000)), data.draw(st.integers(0, 3000))

    def place(tick: int) -> tuple[float, float, float]:
        return plus(reference.at(tick * 0.01).position, others.at(tick * 0.01).position)

    table = table_of(delta, "reference", reference, own)
    payload = encode(StateMessage(2, sent, place(sent), (0.0, 0.0, 0.0)))
    table.absorb([Delivery(sent + age, sent, 2, 0, 0, payload)], sent + age)
    (heard,) = table.states_at(sent + age)
    assert heard.position == pytest.approx(place(sent + age), abs=1e-6)
    assert heard.age == pytest.approx(age * 0.01)


@pytest.mark.parametrize(("mode", "in_place"), [("hold", False), ("neighbour", False), ("reference", True)])
def test_only_the_reference_knows_the_turn_and_the_change(mode: Any, in_place: bool) -> None:
    """On a circle, half-way through a change of the formation, with news two seconds old: the other two modes leave
    the neighbour where it was, or on the tangent."""
    circle = Circle((0.0, 0.0, 10.0), 20.0, 0.6, 0.4, -1.0)
    own = Offset((0.0, 0.0, 0.0), (OffsetChange(10.0, 20.0, (0.0, 4.0, 0.0)),))
    other = Offset((-5.0, 0.0, 0.0), (OffsetChange(10.0, 20.0, (0.0, 9.0, 2.0)),))
    delta = Offset((5.0, 0.0, 0.0), (OffsetChange(10.0, 20.0, (0.0, -5.0, -2.0)),))
    table = table_of(delta, mode, circle, own)
    then, now = (
        [plus(a, b) for a, b in zip(circle.at(t), other.at(t), strict=True)] for t in (18.0, 20.0)
    )  # position, velocity
    table.absorb([Delivery(1810, 1800, 2, 0, 0, encode(StateMessage(2, 1800, then[0], then[1])))], 1810)
    (heard,) = table.states_at(2000)
    assert (math.dist(heard.position, now[0]) < 1e-9) is in_place
    # Then the sum of the consensus error is zero for a vehicle that is in place as well.
    mine = plus(circle.at(20.0).position, own.at(20.0).position)
    assert (math.dist(minus(mine, heard.position), heard.offset) < 1e-9) is in_place
