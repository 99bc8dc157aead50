"""The scene of a log (Foxglove's SceneUpdate) as markers of ROS, for RViz: shapes stay in their frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fleet.ros2.mapping import MessageMaker

CUBE, SPHERE, CYLINDER, LINE_STRIP, TEXT = 1, 2, 3, 4, 9  # visualization_msgs/Marker
LINE_M = 0.15  # a line has its width in pixels, and a marker in metres
TEXT_M = 1.0
MOST = 20_000  # markers of one message


def marker_array(maker: MessageMaker, ns: int, scene: Any) -> Any:
    """Markers of a scene at a time [ns]; a link's state is the text of its line.

    Raises:
        ValueError: the scene has more than is taken.
    """
    found = []
    for marker in _markers(maker, ns, scene):
        found.append(marker)
        if len(found) > MOST:
            raise ValueError(f"a scene of more than {MOST} markers")
    return maker.types.new("visualization_msgs/msg/MarkerArray", markers=found)


def _markers(maker: MessageMaker, ns: int, scene: Any) -> Iterator[Any]:
    for entity in scene.entities:
        text = next((pair.value for pair in entity.metadata if pair.key == "state"), "")
        shapes = [
            *((LINE_STRIP, line, "", {"points": line.points}) for line in entity.lines),
            *((CYLINDER, one, "", {}) for one in entity.cylinders),
            *((SPHERE, one, "", {}) for one in entity.spheres),
            *((CUBE, one, "", {}) for one in entity.cubes),
            *((TEXT, one, one.text, {}) for one in entity.texts),
        ]
        for number, (kind, shape, own, more) in enumerate(shapes):
            yield _marker(maker, ns, entity, number, kind, shape, own or text, more)


def _marker(
    maker: MessageMaker, ns: int, entity: Any, number: int, kind: int, shape: Any, text: str, more: dict[str, Any]
) -> Any:
    new = maker.types.new
    size = {LINE_STRIP: (LINE_M, 0.0, 0.0), TEXT: (0.0, 0.0, TEXT_M)}.get(kind)
    if size is None:
        size = (shape.size.x, shape.size.y, shape.size.z)
    colour, place, turn = shape.color, shape.pose.position, shape.pose.orientation
    turned = (turn.x, turn.y, turn.z, turn.w)
    points = [new("geometry_msgs/msg/Point", x=p.x, y=p.y, z=p.z) for p in more.get("points", ())]
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
