"""From messages of a run's journal to those of ROS: of a live run, of a log that is played, and into a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from google.protobuf.message import DecodeError
from mcap.records import Schema

from fleet.addons.robots.ros2.mapping import (
    DIAGNOSTICS,
    OF_FLEET,
    OF_VEHICLES,
    SCENE,
    TF,
    TF_STATIC,
    MessageMaker,
    RosTopic,
    is_source,
    vehicle_of,
)
from fleet.addons.robots.ros2.types import RosTypes
from fleet.logs.decoder import decode_message, known_class
from fleet.recorder.scene.primitives import NED
from fleet.recorder.transforms import MAP

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # diagnostic_msgs/DiagnosticStatus


class Diagnostics:
    def __init__(self, maker: MessageMaker) -> None:
        self._maker = maker
        self._faults: dict[str, tuple[int, str]] = {}
        self._checks: list[tuple[int, str, str]] = []

    def fault(self, event: Any) -> None:
        lasts = event.action == "begins"
        if lasts or event.fault in self._faults:
            self._faults[event.fault] = (WARN, event.what) if lasts else (OK, f"over: {event.what}")

    def checks(self, rows: Iterable[Mapping[str, Any]]) -> bool:
        """Take the checks as they stand; whether that is something new. `rows`: each with `check`, `asked`, `found` and
        `passed`, which is None until it is judged."""
        new = [_check(row) for row in rows]
        changed = new != self._checks
        self._checks = new
        return changed

    def message(self, ns: int) -> Any:
        rows = [(level, f"fault {name}", text) for name, (level, text) in self._faults.items()]
        return self._maker.types.new(
            "diagnostic_msgs/msg/DiagnosticArray",
            header=self._maker.header(ns, ""),
            status=[self._status(*row) for row in (*rows, *self._checks)],
        )

    def _status(self, level: int, name: str, text: str) -> Any:
        return self._maker.types.new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level, name=f"uuv_fleet: {name}", message=text, hardware_id="uuv-fleet", values=[],
        )  # fmt: skip


def _check(row: Mapping[str, Any]) -> tuple[int, str, str]:
    passed = row.get("passed")
    level = STALE if passed is None else OK if passed else ERROR
    return level, f"check {row.get('check', '')}", f"{row.get('asked', '')}: {row.get('found') or 'not judged yet'}"


CUBE, SPHERE, CYLINDER, LINE_STRIP, TEXT = 1, 2, 3, 4, 9  # visualization_msgs/Marker
LINE_M = 0.15  # a line has its width in pixels, and a marker in metres
TEXT_M = 1.0


def marker_array(maker: MessageMaker, ns: int, scene: Any) -> Any:
    """Markers of a scene at a time [ns]; a link's state is the text of its line."""
    return maker.types.new("visualization_msgs/msg/MarkerArray", markers=list(_markers(maker, ns, scene)))


def _markers(maker: MessageMaker, ns: int, scene: Any) -> Iterator[Any]:
    for entity in scene.entities:
        text = next((pair.value for pair in entity.metadata if pair.key == "state"), "")
        kinds = ((LINE_STRIP, entity.lines), (CYLINDER, entity.cylinders), (SPHERE, entity.spheres),
                 (CUBE, entity.cubes), (TEXT, entity.texts))  # fmt: skip
        for number, (kind, shape) in enumerate((kind, shape) for kind, some in kinds for shape in some):
            yield _marker(maker, ns, entity, number, kind, shape, getattr(shape, "text", "") or text)


def _marker(maker: MessageMaker, ns: int, entity: Any, number: int, kind: int, shape: Any, text: str) -> Any:
    new = maker.types.new
    size = {LINE_STRIP: (LINE_M, 0.0, 0.0), TEXT: (0.0, 0.0, TEXT_M)}.get(kind)
    if size is None:
        size = (shape.size.x, shape.size.y, shape.size.z)
    colour, place, turn = shape.color, shape.pose.position, shape.pose.orientation
    turned = (turn.x, turn.y, turn.z, turn.w)
    points = [new("geometry_msgs/msg/Point", x=p.x, y=p.y, z=p.z) for p in getattr(shape, "points", ())]
    whole: dict[str, Any] = {
        "header": maker.header(ns, entity.frame_id),
        "ns": entity.id,
        "id": number,
        "type": kind,
        "action": 0,
        "pose": maker.pose((place.x, place.y, place.z), turned if any(turned) else (0.0, 0.0, 0.0, 1.0)),
        "scale": maker.vector(size),
        "color": new("std_msgs/msg/ColorRGBA", r=colour.r, g=colour.g, b=colour.b, a=colour.a),
        "lifetime": new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        "frame_locked": entity.frame_locked,
        "points": points,
        "colors": [],
        "text": text,
        "mesh_resource": "",
        "mesh_use_embedded_materials": False,
        "texture_resource": "",
        "texture": new("sensor_msgs/msg/CompressedImage", header=maker.header(0, ""), format="", data=_no_bytes()),
        "uv_coordinates": [],
        "mesh_file": new("visualization_msgs/msg/MeshFile", filename="", data=_no_bytes()),
    }
    return new("visualization_msgs/msg/Marker", **whole)


def _no_bytes() -> Any:
    import numpy as np

    return np.empty(0, np.uint8)


# What a message must have to be one of ours: a log of a stranger may call anything `nav`.
_FIELDS = {
    "nav": ("x", "y", "z", "theta", "psi", "u", "v", "w", "q", "r"),
    "command": ("tau", "applied"),
    "belief": ("covariance",),
    "transforms": ("transforms",),
    "scene": ("entities",),
    "faults": ("fault", "action", "what"),
}
_FIELDS["state"] = _FIELDS["nav"]
_BY_NAME = {topic.name: topic for topic in (*OF_VEHICLES, *OF_FLEET)}


class RosMessage(NamedTuple):
    """A message that is to be published, or written."""

    name: str  # of the topic
    topic: RosTopic
    at_ns: int
    message: Any


class Translation:
    """Translates one journal, message by message, in its order."""

    def __init__(self, types: RosTypes, schemas: Mapping[str, Schema | None]) -> None:
        """Begin; `schemas` as for `learn`."""
        self.maker = MessageMaker(types)
        self.diagnostics = Diagnostics(self.maker)
        self.wanted: Callable[[str], bool] = lambda _: True  # whether messages on a topic of ROS are to be made
        self._classes: dict[str, Any] = {}
        self._covariances: dict[int, tuple[float, ...]] = {}
        self._fixed: Any = None
        self.damaged = 0  # messages that were left out
        self.learn(schemas)

    def learn(self, schemas: Mapping[str, Schema | None]) -> None:
        """Take note of topics of the journal, each with its schema; others are left out."""
        for topic, schema in schemas.items():
            cls = known_class(schema) if is_source(topic) else None
            group = topic.rpartition("/")[2]
            if cls is not None and all(name in cls.DESCRIPTOR.fields_by_name for name in _FIELDS[group]):
                self._classes[topic] = cls

    @property
    def vehicles(self) -> list[int]:
        return sorted({found[0] for topic in self._classes if (found := vehicle_of(topic))})

    def topics(self) -> list[tuple[str, RosTopic]]:
        """The names of all topics of ROS that there can be messages on, and what they are."""
        found = [
            (topic.name.format(i=i), topic)
            for i in self.vehicles
            for topic in OF_VEHICLES
            if topic.source.format(i=i) in self._classes
        ]
        there = {TF: "transforms", TF_STATIC: "transforms", SCENE: "scene"}
        return found + [(t.name, t) for t in OF_FLEET if t.name not in there or there[t.name] in self._classes]

    def __call__(self, topic: str, at_ns: int, data: bytes) -> Iterator[RosMessage]:
        cls = self._classes.get(topic)
        if cls is None:
            return
        try:
            message = decode_message(cls, data)
            found = vehicle_of(topic)
            made = self._of_fleet(topic, at_ns, message) if found is None else self._of_vehicle(*found, at_ns, message)
            yield from made
        except (DecodeError, ValueError, TypeError, AttributeError):  # fields of other types, or too much of them
            self.damaged += 1

    def _of_vehicle(self, i: int, group: str, at_ns: int, message: Any) -> list[RosMessage]:
        make, made = self.maker, self._made
        match group:
            case "belief":
                self._covariances[i] = tuple(message.covariance)
                return []
            case "state":
                return made(i, at_ns, {"ground_truth/odom": lambda: make.odometry(at_ns, i, message)})
            case "command":
                force, pitch, yaw = message.applied
                applied = (force, pitch, yaw)
                return made(i, at_ns, {"applied_wrench": lambda: make.wrench_stamped(at_ns, i, applied)})
        return made(i, at_ns, {
            "odom": lambda: make.odometry(at_ns, i, message, self._covariances.get(i, ())),
            "twist": lambda: make.twist_stamped(at_ns, i, message),
            "imu": lambda: make.imu(at_ns, i, message),
            "pressure": lambda: make.pressure(at_ns, i, message),
        })  # fmt: skip

    def _made(self, i: int, at_ns: int, some: Mapping[str, Callable[[], Any]]) -> list[RosMessage]:
        return [
            RosMessage(f"/uuv_{i}/{name}", _BY_NAME[f"/uuv_{{i}}/{name}"], at_ns, make())
            for name, make in some.items()
            if self.wanted(f"/uuv_{i}/{name}")
        ]

    def _of_fleet(self, topic: str, at_ns: int, message: Any) -> list[RosMessage]:
        if topic == "scene":
            made = marker_array(self.maker, at_ns, message) if self.wanted(SCENE) else None
            return [] if made is None else [self._message(SCENE, at_ns, made)]
        if topic == "faults":
            self.diagnostics.fault(message)
            return [self.diagnostics_message(at_ns)]
        return self._transforms(at_ns, message)

    def _transforms(self, at_ns: int, message: Any) -> list[RosMessage]:
        moving, fixed = [], []
        for one in message.transforms:
            t, r = one.translation, one.rotation
            if (one.parent_frame_id, one.child_frame_id) == (MAP, NED):
                fixed.append((r.x, r.y, r.z, r.w))
                continue
            place, turn = (t.x, t.y, t.z), (r.x, r.y, r.z, r.w)
            moving.append(self.maker.transform(at_ns, one.parent_frame_id, one.child_frame_id, place, turn))
        found = [self._message(TF, at_ns, self.maker.transforms(moving))]
        if fixed and self._fixed is None:
            self._fixed = self.maker.static_transforms(fixed[0], self.vehicles)
            found.insert(0, self._message(TF_STATIC, at_ns, self._fixed))
        return found

    def diagnostics_message(self, at_ns: int) -> RosMessage:
        return self._message(DIAGNOSTICS, at_ns, self.diagnostics.message(at_ns))

    @staticmethod
    def _message(name: str, at_ns: int, message: Any) -> RosMessage:
        return RosMessage(name, _BY_NAME[name], at_ns, message)
