"""The drawing for 3D viewers, as Foxglove's SceneUpdate: hulls, links and the places where the vehicles should be.

Every message is complete: a viewer that jumps to a time looks no further back than to the last message of a topic, and
a log that goes on from another has none before its beginning. All that is remembered from one to the next is what
became of the last packets of each link, and such a run takes that over. Links and places are drawn in `reference`,
which moves with the fleet, so that they hardly lag behind the hulls between two messages. Hulls once at the start and
links on change were rejected for this reason, although transforms and scenes take 39 kB per vehicle-minute. The state
of a link is that of its last ten packets: over a window of time an acoustic link would be grey between its slots.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from math import sqrt

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from fleet.recorder.scene.belief import PlaceBelief, belief_primitives
from fleet.recorder.scene.link_state import HISTORY, LinkState, mark_of, state_of
from fleet.recorder.scene.model import SLENDER, SceneModel, diameter
from fleet.recorder.scene.primitives import REFERENCE, CircleShape, CrossShape, Primitive, points_of
from fleet.recorder.scene.styles import FOXGLOVE, NO_AGENT
from fleet.recorder.template import Template, field
from fleet.recorder.transforms import NO_TURN, enu
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import WHERE_LOCATED, locates
from netem.condition import Link
from netem.wire.messages import Command, Fate, Frame, VehicleFrame
from world.vectors import Vec3

SCENE_UNITS = {
    "entities": ["m", "lengths and positions in each entity's frame; thickness and font_size in pixels"],
}

_ARMS = ((-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5))  # ends of the arms of a cross [m]
UNHEARD_NS = 500_000_000  # after so long without a command an agent counts as absent


class LinkHistories:
    """The marks that the last packets of each link left; see `fleet.recorder.scene.styles`."""

    def __init__(self, links: Iterable[Link]) -> None:
        self._of: dict[Link, deque[str]] = {link: deque(maxlen=HISTORY) for link in links}

    def settle(self, fate: Fate) -> None:
        """Take one packet's fate; what is in flight at the end has none."""
        mark = mark_of(fate.cause, corrupted=fate.corrupted)
        if mark:
            self._of[fate.src, fate.dst].append(mark)

    def state(self, link: Link) -> LinkState:
        """SILENT before the first packet, CUT, LOSING or DELIVERING."""
        return state_of("".join(self._of[link]))


class Scene:
    """The scene of one run; receives packets and frames as the log is written."""

    def __init__(self, scenario: Scenario, links: LinkHistories | None = None) -> None:
        """`links`: those of the run that this one continues."""
        self._scenario = scenario
        self._model = SceneModel(scenario)
        self.links = links or LinkHistories(scenario.graph.links)
        self._seen: Frame | None = None  # the last at which they were asked
        self._commanded: dict[int, int] = {}  # at which tick last
        masses = {i: scenario.controls[i - 1].vehicle.m for i in range(1, scenario.vehicles + 1)}
        self._hulls = {
            (i, silent): hull(i, mass, silent).SerializeToString()
            for i, mass in masses.items()
            for silent in (False, True)
        }
        self._navigating = frozenset(self._model.navigating)
        self._locating = frozenset(i for i in self._navigating if locates(scenario.layout(i)))
        self._telemetry: dict[int, Sequence[float]] = {}  # of vehicles that locate themselves, now
        self._beliefs: dict[tuple[int, int], Template] = {}  # by vehicle and number of coordinates
        self._names = {
            (src, dst): SceneEntity(frame_id=REFERENCE, id=f"link {src}-{dst}", frame_locked=True).SerializeToString()
            for src, dst in scenario.graph.links
        }
        self._lines = {state: Template(partial(_line, state), 6) for state in FOXGLOVE.links}
        self._offsets: list[Vec3] = []  # where the vehicles should be in the message before
        self._formation = b""  # the formation as it is drawn

    def see(self, frame: Frame, commands: Mapping[int, Command]) -> None:
        """Note a tick, and the commands of the vehicles, of which the end tick has none. On a wall clock an agent may
        miss ticks; it is silent when it has missed them for a while.
        """
        if self._locating:
            self._telemetry = {i: commands[i].telemetry for i in self._locating & commands.keys()}
        if frame.tick == self._scenario.ticks:
            return
        self._commanded.update(dict.fromkeys(commands, frame.tick))
        self._seen = frame

    def message(self, frame: Frame, stamp: bytes) -> bytes:
        """A SceneUpdate message: hulls, links, beliefs, places of the vehicles; `stamp` is `stamp_field`'s."""
        silent = self.silent()
        found = [field(b"\x12", stamp + self._hulls[row.id, row.id in silent]) for row in frame.vehicles]
        t = frame.tick * self._scenario.tick_ns / 1e9
        origin = self._model.reference(t)
        places = {row.id: _relative(row.eta[:3], origin) for row in frame.vehicles}
        for link, name in self._names.items():
            found.append(field(b"\x12", stamp + name + self._line(link, places, silent)))
        believers = (row for row in frame.vehicles if row.id in self._navigating)
        found += [field(b"\x12", stamp + self._belief(row, places[row.id])) for row in believers]
        offsets = self._model.offsets(t)
        if offsets != self._offsets:
            self._offsets = offsets
            self._formation = _formation(self._model.moving(t), self._model.diameters).SerializeToString()
        found.append(field(b"\x12", stamp + self._formation))
        return b"".join(found)

    def _belief(self, row: VehicleFrame, place: Vec3) -> bytes:
        """The vehicle's belief about its place; at a tick without one an empty entity that replaces the one before."""
        drawn: list[Primitive] = []
        if row.nav:
            off = [believed - true for believed, true in zip(row.nav[:3], row.eta[:3], strict=True)]
            belief = PlaceBelief.by_navigator(off, row.belief)
            if telemetry := self._telemetry.get(row.id):
                x, y, _, *covariance = telemetry[WHERE_LOCATED]
                belief = belief.by_ranges((x - row.eta[0], y - row.eta[1]), covariance)
            drawn = belief_primitives(row.id, belief)
        x, y, z = place
        values = [value for thing in drawn for dx, dy, dz in _ends(thing) for value in (x + dx, y + dy, z + dz)]
        key = row.id, len(values)
        if key not in self._beliefs:
            self._beliefs[key] = Template(partial(_believed, row.id), len(values))
        return self._beliefs[key](*values)

    def silent(self) -> frozenset[int]:
        if self._seen is None or self._scenario.nodes:
            return frozenset()
        since = self._seen.tick - UNHEARD_NS // self._scenario.tick_ns
        rows = self._seen.vehicles
        return frozenset(row.id for row in rows if not row.nav or self._commanded.get(row.id, 0) < since)

    def _line(self, link: Link, places: dict[int, Vec3], silent: frozenset[int]) -> bytes:
        """The half of the line that is nearer to the receiver; all of it where nothing comes the other way."""
        src, dst = link
        state = LinkState.SILENT if src in silent else self.links.state(link)
        begin, end = places[src], places[dst]
        if link in self._model.both_ways:
            (x, y, z), (u, v, w) = begin, end
            begin = (x + u) / 2, (y + v) / 2, (z + w) / 2
        return self._lines[state](*begin, *end)


def _line(state: LinkState, *ends: float) -> SceneEntity:
    """And what follows: its state, and a line between two points."""
    colour, width, _ = FOXGLOVE.links[state]
    line = LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        thickness=width,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in (ends[:3], ends[3:])],
        color=_colour(colour),
    )
    return SceneEntity(metadata=[KeyValuePair(key="state", value=state.value)], lines=[line])


def _formation(things: Iterable[Primitive], diameters: Sequence[float]) -> SceneEntity:
    """Spheres where the vehicles should be, twice as thick as the vehicle, and one in the reference point.

    Other primitives are left out: what a log holds of a scene keeps its bytes.
    """
    spheres = []
    for thing in things:
        match thing:
            case CrossShape(at=at) if at.frame == REFERENCE:
                spheres.append(_sphere((at.east, at.north, at.down), max(diameters), FOXGLOVE.colour(thing.colour)))
            case CircleShape(at=at, vehicle=i) if at.frame == REFERENCE:
                place = enu((at.north, at.east, at.down))
                spheres.append(_sphere(place, 2.0 * diameters[i - 1], FOXGLOVE.colour(thing.colour), 0.5))
    return SceneEntity(frame_id=REFERENCE, id="formation", frame_locked=True, spheres=spheres)


def _believed(i: int, *values: float) -> SceneEntity:
    """The belief of vehicle i: the corners of an area, which may be left out, and the four ends of a cross [m]."""
    points = [Point3(x=x, y=y, z=z) for x, y, z in zip(values[::3], values[1::3], values[2::3], strict=True)]
    colour = _colour(FOXGLOVE.vehicle(i))
    lines = [
        LinePrimitive(type=kind, thickness=1.5, scale_invariant=True, points=some, color=colour)
        for kind, some in ((LinePrimitive.LINE_LOOP, points[:-4]), (LinePrimitive.LINE_LIST, points[-4:]))
        if some
    ]
    return SceneEntity(frame_id=REFERENCE, id=f"belief {i}", frame_locked=True, lines=lines)


def _ends(thing: Primitive) -> list[Vec3]:
    points = [enu((point.north, point.east, point.down)) for point in points_of(thing)]
    return [(x + dx, y + dy, z) for x, y, z in points for dx, dy in _ARMS] if isinstance(thing, CrossShape) else points


def hull(i: int, mass: float, silent: bool) -> SceneEntity:
    """A torpedo around the origin of `uuv-<i>`, forward along x: body, nose, tail cone, cross of fins, and its number,
    of a size by `mass` [kg]. `silent`: the vehicle gets no command.
    """
    d = diameter(mass)
    length = SLENDER * d
    colour = _colour(FOXGLOVE.colour(NO_AGENT) if silent else FOXGLOVE.vehicle(i))
    forward = Quaternion(y=sqrt(0.5), w=sqrt(0.5))  # a cylinder's axis is z

    def at(x: float, turn: Quaternion = NO_TURN) -> Pose:
        return Pose(position=Vector3(x=x), orientation=turn)

    return SceneEntity(
        frame_id=f"uuv-{i}",
        id=f"uuv-{i}",
        frame_locked=True,
        metadata=[KeyValuePair(key="agent", value="silent" if silent else "commanding")],
        cylinders=[
            CylinderPrimitive(
                pose=at(x * length, forward),
                size=Vector3(x=d, y=d, z=long * length),
                bottom_scale=bottom,
                top_scale=1.0,
                color=colour,
            )
            for x, long, bottom in ((0.05, 0.6, 1.0), (-0.375, 0.25, 0.3))
        ],
        spheres=[SpherePrimitive(pose=at(0.35 * length), size=Vector3(x=0.3 * length, y=d, z=d), color=colour)],
        cubes=[
            CubePrimitive(
                pose=at(-0.45 * length), size=Vector3(x=0.08 * length, y=span, z=1.6 * d + 0.1 * d - span), color=colour
            )
            for span in (1.6 * d, 0.1 * d)
        ],
        texts=[
            TextPrimitive(
                pose=Pose(position=Vector3(z=-1.5 * d), orientation=NO_TURN),
                billboard=True,
                font_size=16.0,
                scale_invariant=True,
                color=colour,
                text=f"{i} silent" if silent else f"{i}",
            )
        ],
    )


def _colour(code: str, alpha: float = 1.0) -> Color:
    r, g, b = (int(code[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=alpha)


def _sphere(place: Vec3, size: float, colour: str, alpha: float = 1.0) -> SpherePrimitive:
    x, y, z = place
    return SpherePrimitive(
        pose=Pose(position=Vector3(x=x, y=y, z=z), orientation=NO_TURN),
        size=Vector3(x=size, y=size, z=size),
        color=_colour(colour, alpha),
    )


def _relative(place: Iterable[float], origin: Vec3) -> Vec3:
    """A place in `reference`, of two in `ned`."""
    x, y, z = (one - other for one, other in zip(place, origin, strict=True))
    return enu((x, y, z))
