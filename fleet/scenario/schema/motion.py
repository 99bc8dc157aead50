"""Reference, formation, graph and initial states.

The tables of named shapes say which keys each shape takes. A section holds the keys of all its shapes, and
`fleet.scenario.rules.motion` compares them with its table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from fleet.quantities import QuantityError, describe_value, vehicle_numbers
from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, mistake


class ShapeKeys(NamedTuple):
    """The keys that a shape needs, and further keys that it may have."""

    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        return self.needed + self.optional


REFERENCE: dict[str, ShapeKeys] = {
    "line": ShapeKeys(("start", "velocity")),
    "circle": ShapeKeys(("center", "radius", "speed"), ("bearing", "turn")),
    "helix": ShapeKeys(("center", "radius", "speed", "sink"), ("bearing", "turn")),
    "lawn-mower": ShapeKeys(("start", "leg", "legs", "spacing", "speed"), ("heading", "turn")),
    "waypoints": ShapeKeys(("points", "speed", "acceleration"), ("closed",)),
}
FORMATION: dict[str, ShapeKeys] = {
    "offsets": ShapeKeys(("offsets",)),
    "line": ShapeKeys((), ("spacing", "heading")),
    "column": ShapeKeys((), ("spacing", "heading")),
    "wedge": ShapeKeys((), ("spacing", "heading")),
    "circle": ShapeKeys((), ("spacing", "heading")),
    "grid": ShapeKeys((), ("spacing", "heading")),
}
GRAPH: dict[str, ShapeKeys] = {
    "edges": ShapeKeys(("edges",)),
    "path": ShapeKeys((), ("ahead", "behind")),
    "ring": ShapeKeys((), ("ahead", "behind")),
    "star": ShapeKeys((), ("hub", "weight")),
    "complete": ShapeKeys((), ("weight",)),
    "nearest": ShapeKeys((), ("count", "weight")),
    "random": ShapeKeys((), ("probability", "weight")),
}

DEFAULT_SPACING_M = 10.0  # the sides of the paper's square
DEFAULT_NEAREST = 2
DEFAULT_PROBABILITY = 0.2


class ReferenceSection(Section):
    """The trajectory that the fleet follows, the paper's eta_1^d(t); `shapes` lists the keys of each shape."""

    shape: Literal["line", "circle", "helix", "lawn-mower", "waypoints"] | None = None  # line
    start: v.Position | None = None  # NED: north, east, down
    velocity: v.Velocity | None = None
    speed: v.PositiveSpeed | None = None
    center: v.Position | None = None
    radius: v.PositiveLength | None = None
    bearing: v.SignedAngle | None = None  # where the start is as seen from the centre, clockwise from north
    turn: Literal["starboard", "port"] | None = None  # starboard
    sink: v.SignedSpeed | None = None  # speed at which a helix goes down
    heading: v.SignedAngle | None = None  # the first leg of a lawn-mower, clockwise from north
    leg: v.PositiveLength | None = None
    legs: Annotated[int, Field(ge=1, le=1000)] | None = None
    spacing: v.PositiveLength | None = None
    points: list[v.Position] | None = None
    acceleration: v.PositiveAcceleration | None = None  # in the turns at waypoints
    closed: bool | None = None  # waypoints: from the last one back to the first, again and again


class FormationShape(Section):
    """The place of each vehicle in the formation: explicit `offsets`, or a named `shape`."""

    offsets: list[v.Position] | None = None  # p_1, p_2, ...; Delta_ij = p_i - p_j
    shape: Literal["line", "column", "wedge", "circle", "grid"] | None = None
    spacing: v.PositiveLength | None = None  # distance between neighbours; default: 10 m
    heading: v.SignedAngle | None = None  # what is ahead in the shape, clockwise from north; 0


class FormationChange(FormationShape):
    """A new formation, which the vehicles take up smoothly in the time `over`."""

    at: v.Time
    over: v.Period


class FormationSection(FormationShape):
    """The place of each vehicle relative to the reference, and how it changes."""

    changes: list[FormationChange] | None = None


class _Followers:
    """`all`, or a list of numbers, or `1` or `2-4, 7` as everywhere else where vehicles are named.

    A plain union would report a mistake in the list once per alternative.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            self._validate,
            handler.generate_schema(list[int]),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda value: value),
        )

    @staticmethod
    def _validate(value: Any, numbers: Callable[[Any], list[int]]) -> Any:
        if value == "all":
            return value
        if isinstance(value, list):
            return numbers(value)
        if isinstance(value, int) and not isinstance(value, bool):
            return [value]
        if isinstance(value, str) and value[:1].isdigit():
            try:
                return vehicle_numbers(value)
            except QuantityError as error:
                raise mistake(error.message) from None
        raise mistake(f'expected "all" or a list of vehicle numbers such as [1, 3], got {describe_value(value)}')


class StandbySection(Section):
    """Vehicles that follow the reference themselves while those of their neighbours that follow it are silent."""

    vehicles: v.VehicleNumbers
    after: v.Period  # the silence after which they take over


class GraphSection(Section):
    """The communication graph, as `edges` or as a named `shape`; and the vehicles that follow the reference."""

    shape: Literal["path", "ring", "star", "complete", "nearest", "random"] | None = None
    ahead: v.PositiveNumber | None = None  # path, ring: a_(i,i-1); 1
    behind: v.PositiveNumber | None = None  # path, ring: a_(i,i+1); 1
    weight: v.PositiveNumber | None = None  # the other shapes: every a_ij; 1
    hub: Annotated[int, Field(ge=1)] | None = None  # star: the vehicle that is linked with all others; 1
    count: Annotated[int, Field(ge=1)] | None = None  # nearest: how many others each vehicle receives from; 2
    probability: v.Probability | None = None  # random: of each pair beyond the tree that connects all; 20 %
    edges: dict[str, v.PositiveNumber] | None = None  # "1->2": a_21, vehicle 2 receives from vehicle 1
    reference: Annotated[list[int] | Literal["all"], _Followers()] = "all"  # vehicles with b_i = 1; the others have 0
    standby: StandbySection | None = None  # the vehicles that get b_i = 1 when `reference` is silent


class InitialState(Section):
    """One vehicle at t = 0."""

    position: v.Position
    pitch: v.SignedAngle = 0.0
    yaw: v.SignedAngle = 0.0
    surge: v.SignedSpeed = 0.0
    sway: v.SignedSpeed = 0.0
    heave: v.SignedSpeed = 0.0
    pitch_rate: v.SignedAngularRate = 0.0
    yaw_rate: v.SignedAngularRate = 0.0
    roll: v.SignedAngle = 0.0  # only a vehicle with a plant has a roll and a roll rate
    roll_rate: v.SignedAngularRate = 0.0


class Scatter(Section):
    """Every vehicle near its place: x and y uniform within the scatter, z below the place by at most it.

    With `around: origin` the place is the vehicle's offset p_i; with `around: reference` it is the vehicle's place in
    the formation at t = 0, with the course of the reference.
    """

    scatter: v.Length
    surge: v.SignedSpeed = 0.0
    around: Literal["origin", "reference"] = "origin"


def read_initial(value: Any) -> Any:
    """The model's form of what the file has: a list of states, or a scatter."""
    if isinstance(value, list):
        return {"vehicles": value}
    if isinstance(value, dict):
        return {"scatter": value}
    raise mistake(f"expected a list with one entry per vehicle, or a scatter, got {describe_value(value)}")


class InitialSection(Section):
    """Either the state of each vehicle or a scatter; the file has only one of them."""

    vehicles: list[InitialState] | None = None
    scatter: Scatter | None = None


def show_initial(initial: InitialSection) -> Any:
    """The file's form of the initial states: a list or a scatter."""
    entries = initial.vehicles if initial.vehicles is not None else initial.scatter
    if entries is None:
        return None
    if isinstance(entries, list):
        return [entry.model_dump(exclude_defaults=True) for entry in entries]
    return entries.model_dump(exclude_defaults=True)
