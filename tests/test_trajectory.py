"""References and changing offsets: laws of motion, and what agents make of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgpack
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from loops import agent_config

from agents.config import AgentConfig, Neighbour
from agents.neighbours import NeighbourTable
from agents.payload import StateMessage, encode
from agents.trajectory import Change, Circle, Line, Offset, Path, PathError, Reference, minus, plus
from netem.messages import Delivery

coordinate = st.floats(-200.0, 200.0)
points = st.tuples(coordinate, coordinate, st.floats(0.0, 50.0))


@st.composite
def references(draw: st.DrawFn) -> Reference:
    """A line, a circle or helix, or a path through random points."""
    kind = draw(st.sampled_from(["line", "circle", "path"]))
    speed = draw(st.floats(0.1, 3.0))
    if kind == "line":
        return Line(draw(points), (speed, draw(st.floats(-1.0, 1.0)), 0.0))
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
        start,
        tuple(Change(sum(times[: n + 1]) + sum(blends[:n]), blends[n], end) for n, end in enumerate(ends)),
    ),
    points,
    st.lists(points, max_size=3),
    st.lists(st.floats(0.0, 20.0), min_size=3, max_size=3),
    st.lists(st.floats(1.0, 20.0), min_size=3, max_size=3),
)


@given(references(), st.floats(0.0, 500.0))
@settings(max_examples=200, deadline=None)
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
@settings(max_examples=200, deadline=None)
def test_velocity_stays_within_its_bounds(reference: Reference, t: float) -> None:
    """The QP's bounds are checked against these; sampled to a degree, so to 0.02 % of the speed."""
    low, high = reference.velocity_bounds()
    for least, value, most in zip(low, reference.at(t).velocity, high, strict=True):
        slack = 2e-4 * getattr(reference, "speed", 1.0) + 1e-12
        assert least - slack <= value <= most + slack


@given(references(), st.floats(0.0, 500.0))
@settings(max_examples=100, deadline=None)
def test_speed_along_a_path_is_constant(reference: Reference, t: float) -> None:
    if isinstance(reference, Path):
        assert math.hypot(*reference.at(t).velocity) == pytest.approx(reference.speed)
    if isinstance(reference, Circle):
        assert math.hypot(*reference.at(t).velocity[:2]) == pytest.approx(reference.speed)
        x, y, _ = minus(reference.at(t).position, reference.center)
        assert math.hypot(x, y) == pytest.approx(reference.radius)


@given(references(), st.floats(0.0, 200.0), st.floats(0.0, 50.0))
@settings(max_examples=100, deadline=None)
def test_displacement_is_the_way_between(reference: Reference, begin: float, span: float) -> None:
    way = minus(reference.at(begin + span).position, reference.at(begin).position)
    assert reference.displacement(begin, span) == pytest.approx(way, abs=1e-9)


def test_a_closed_path_comes_round() -> None:
    path = Path(((0.0, 0.0, 5.0), (50.0, 0.0, 5.0), (50.0, 40.0, 10.0)), 0.7, 4.0, closed=True)
    lap = path.length / path.speed
    for t in (0.0, 13.0, 100.0):
        assert path.at(t + lap).position == pytest.approx(path.at(t).position, abs=1e-9)


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
@settings(max_examples=200, deadline=None)
def test_a_blend_is_smooth(offset: Offset, t: float) -> None:
    """The rate is the derivative, bounded by 1.875 of an even pace, and zero where nothing changes."""
    h = 1e-5
    now, after = offset.at(t), offset.at(t + h)
    places = [offset.start, *(change.offset for change in offset.changes)]
    pace = max(
        (math.dist(a, b) / c.blend for a, b, c in zip(places, places[1:], offset.changes, strict=False)), default=0.0
    )
    assert math.hypot(*now.velocity) <= 1.875 * pace + 1e-9
    for axis in range(3):
        derivative = (after.position[axis] - now.position[axis]) / h
        assert derivative == pytest.approx(now.velocity[axis], abs=1e-4 + 20.0 * pace * h)
    if offset.changes and t > offset.changes[-1].begin + offset.changes[-1].blend:
        assert now == (offset.changes[-1].offset, (0.0, 0.0, 0.0))


@given(references(), offsets, offsets)
@settings(max_examples=50, deadline=None)
def test_configuration_travels(reference: Reference, own: Offset, other: Offset) -> None:
    """to_values is plain MessagePack, from_values its inverse."""
    config = replace(agent_config(1), reference=reference, offset=own, neighbours=(Neighbour(2, 0.8, other),))
    again = AgentConfig.from_values(msgpack.unpackb(msgpack.packb(config.to_values())))
    assert again == config
    assert again.desired(12.3) == config.desired(12.3)


@given(references(), st.data())
@settings(max_examples=100, deadline=None)
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

    table = NeighbourTable((Neighbour(2, 1.0, delta),), "reference", reference, own, 0.01)
    payload = encode(StateMessage(2, sent, place(sent), (0.0, 0.0, 0.0)))
    table.absorb([Delivery(sent + age, sent, 2, 0, 0, payload)], sent + age)
    (heard,) = table.heard(sent + age)
    assert heard.position == pytest.approx(place(sent + age), abs=1e-6)
    assert heard.age == pytest.approx(age * 0.01)
