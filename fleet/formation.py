"""Where each vehicle belongs: the offsets p_i of a formation, and the states at t = 0.

| symbol | meaning | unit, frame |
|---|---|---|
| p_i | offset of vehicle i from the reference: eta_i^d = eta_1^d + p_i | m, NED |
| Delta_ij | p_i - p_j, what vehicle i keeps from its neighbour j (eq. 10) | m, NED |
| eta0, nu0 | x, y, z, theta, psi and u, v, w, q, r at t = 0 | m, rad; m/s, rad/s |
"""

from __future__ import annotations

import math

from fleet.schema import FormationSection, InitialSection
from netem.draws import uniform
from world.vehicle import Vec3, Vec5

DEFAULT_SPACING_M = 10.0  # the sides of the paper's square


def offsets(formation: FormationSection, vehicles: int) -> tuple[Vec3, ...]:
    """The offsets p_1, p_2, ... [m, NED]."""
    if formation.offsets is not None:
        return tuple(formation.offsets)
    return grid(vehicles, formation.spacing or DEFAULT_SPACING_M)


def grid(vehicles: int, spacing: float) -> tuple[Vec3, ...]:
    """A horizontal square grid, filled to and fro, so that vehicles with consecutive numbers are neighbours.

    Four vehicles at 10 m are the paper's square.

    Args:
        spacing: side of a cell [m].

    Returns:
        The offsets [m, NED]; vehicle 1 is at the reference, the rows go to port and follow each other north.
    """
    columns = math.isqrt(vehicles - 1) + 1
    places: list[Vec3] = []
    for number in range(vehicles):
        row, column = divmod(number, columns)
        if row % 2:
            column = columns - 1 - column
        places.append((row * spacing, 0.0 - column * spacing, 0.0))
    return tuple(places)


def initial_states(initial: InitialSection, places: tuple[Vec3, ...], seed: int) -> tuple[tuple[Vec5, Vec5], ...]:
    """(eta0, nu0) of every vehicle.

    A scatter puts vehicle i at p_i plus draws that depend on (seed, i) alone, so that a larger fleet starts
    with the same first vehicles. It never lifts a vehicle: z is down, and nobody should start above the
    surface."""
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
    states: list[tuple[Vec5, Vec5]] = []
    for number, (x, y, z) in enumerate(places, start=1):
        dx, dy, dz = (uniform(seed, "scatter", number, axis) for axis in range(3))
        eta0 = (x + radius * (2.0 * dx - 1.0), y + radius * (2.0 * dy - 1.0), z + radius * dz, 0.0, 0.0)
        states.append((eta0, (surge, 0.0, 0.0, 0.0, 0.0)))
    return tuple(states)
