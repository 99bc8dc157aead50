"""The place of each vehicle: the offsets p_i of a formation, and the states at t = 0.

| symbol | meaning | unit, frame |
|---|---|---|
| p_i | offset of vehicle i from the reference: eta_i^d = eta_1^d + p_i | m, NED |
| Delta_ij | p_i - p_j, what vehicle i keeps from its neighbour j (eq. 10) | m, NED |
| eta0, nu0 | x, y, z, theta, psi and u, v, w, q, r at t = 0 | m, rad; m/s, rad/s |
"""

from __future__ import annotations

import math
from math import cos, pi, sin

from agents.offset import Offset, OffsetChange
from agents.trajectory import Motion
from fleet.scenario.schema.motion import (
    DEFAULT_SPACING_M,
    FormationSection,
    FormationShape,
    InitialSection,
)
from netem.draws import uniform
from world.vectors import Vec2, Vec3, Vec5, plus


def plans(formation: FormationSection, vehicles: int) -> tuple[Offset, ...]:
    """The offset of each vehicle over time."""
    start = offsets(formation, vehicles)
    changes = [(change, offsets(change, vehicles)) for change in formation.changes or ()]
    return tuple(
        Offset(place, tuple(OffsetChange(c.at / 1e9, c.over / 1e9, places[i]) for c, places in changes))
        for i, place in enumerate(start)
    )


def offsets(formation: FormationShape, vehicles: int) -> tuple[Vec3, ...]:
    """The offsets p_1, p_2, ... [m, NED] of one shape."""
    if formation.offsets is not None:
        return tuple(formation.offsets)
    assert formation.shape is not None
    places = SHAPES[formation.shape](vehicles, formation.spacing or DEFAULT_SPACING_M)
    heading = formation.heading or 0.0
    if heading:
        c, s = cos(heading), sin(heading)
        places = tuple((c * ahead - s * right, s * ahead + c * right, down) for ahead, right, down in places)
    return places


def line(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """Side by side: vehicle 1 at the reference, the others to port of each other."""
    return tuple((0.0, 0.0 - n * spacing, 0.0) for n in range(vehicles))


def column(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """One behind the other: vehicle 1 at the reference, in front."""
    return tuple((0.0 - n * spacing, 0.0, 0.0) for n in range(vehicles))


def wedge(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """A right-angled V, vehicle 1 at its point, even numbers to starboard, odd ones to port."""
    side = spacing / math.sqrt(2.0)
    places: list[Vec3] = []
    for n in range(vehicles):
        row = (n + 1) // 2
        places.append((0.0 - row * side, (1.0 if n % 2 else -1.0) * row * side + 0.0, 0.0))
    return tuple(places)


def circle(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """A ring round the reference, vehicle 1 ahead, clockwise, with `spacing` [m] between neighbours."""
    if vehicles == 1:
        return ((0.0, 0.0, 0.0),)
    radius = spacing / (2.0 * sin(pi / vehicles))
    return tuple(
        (radius * cos(2.0 * pi * n / vehicles), radius * sin(2.0 * pi * n / vehicles), 0.0) for n in range(vehicles)
    )


def grid(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """A horizontal square grid, filled to and fro, so that vehicles with consecutive numbers are neighbours.

    Four vehicles at 10 m are the paper's square.

    `spacing`: side of a cell [m]. Returns the offsets [m, NED]; vehicle 1 is at the reference, the rows go to port and
    follow each other north.
    """
    columns = math.isqrt(vehicles - 1) + 1
    places: list[Vec3] = []
    for number in range(vehicles):
        row, column = divmod(number, columns)
        if row % 2:
            column = columns - 1 - column
        places.append((row * spacing, 0.0 - column * spacing, 0.0))
    return tuple(places)


SHAPES = {"line": line, "column": column, "wedge": wedge, "circle": circle, "grid": grid}


def initial_states(
    initial: InitialSection, places: tuple[Vec3, ...], start: Motion, seed: int
) -> tuple[tuple[Vec5, Vec5], ...]:
    """(eta0, nu0) of every vehicle; `start` is the reference at t = 0.

    A scatter puts vehicle i at its place plus draws that depend on (seed, i) alone, so that a larger fleet starts
    with the same first vehicles. It moves a vehicle only down (z is down), so that none starts above the surface.
    """
    if initial.vehicles is not None:
        return tuple(
            (
                (*state.position, state.pitch, state.yaw),
                (state.surge, state.sway, state.heave, state.pitch_rate, state.yaw_rate),
            )
            for state in initial.vehicles
        )
    assert initial.scatter is not None
    radius, surge = initial.scatter.scatter, initial.scatter.surge
    origin, yaw = (0.0, 0.0, 0.0), 0.0
    if initial.scatter.around == "reference":
        origin, yaw = start.position, math.atan2(start.velocity[1], start.velocity[0])
    states: list[tuple[Vec5, Vec5]] = []
    for number, place in enumerate(places, start=1):
        x, y, z = plus(origin, place)
        dx, dy, dz = (uniform(seed, "scatter", number, axis) for axis in range(3))
        eta0 = (x + radius * (2.0 * dx - 1.0), y + radius * (2.0 * dy - 1.0), z + radius * dz, 0.0, yaw)
        states.append((eta0, (surge, 0.0, 0.0, 0.0, 0.0)))
    return tuple(states)


def initial_rolls(initial: InitialSection, vehicles: int) -> tuple[Vec2, ...]:
    """Roll [rad] and roll rate [rad/s] of every vehicle at the start; those without a plant have none."""
    if initial.vehicles is None:
        return ((0.0, 0.0),) * vehicles
    return tuple((state.roll, state.roll_rate) for state in initial.vehicles)
