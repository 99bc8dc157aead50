"""Where every vehicle is, as Foxglove's FrameTransforms: the tree of frames that 3D viewers draw in.

| frame | what | axes |
|---|---|---|
| `map` | the root | east, north, up: viewers have z upwards |
| `ned` | all positions of the log | north, east, down; same origin |
| `reference` | moves with the reference trajectory | parallel to `map` |
| `uuv-<i>` | vehicle i | forward, starboard, down |

Every message has all of them: a viewer that jumps to a time needs no older one.
"""

from __future__ import annotations

from math import asin, atan2, cos, sin, sqrt

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from fleet.recorder.scene.primitives import NED, REFERENCE
from fleet.recorder.template import Template, field
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Frame
from world.vectors import Vec3

MAP = "map"
TRANSFORMS_UNITS = {
    "transforms.translation": ["m", "of the child's origin in the parent"],
    "transforms.rotation": ["1", "unit quaternion, child to parent"],
}
NO_TURN = Quaternion(w=1.0)
_UPSIDE_DOWN = Quaternion(x=sqrt(0.5), y=sqrt(0.5))  # half a turn about north-east: NED to east, north, up


class Transforms:
    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._ned = FrameTransform(parent_frame_id=MAP, child_frame_id=NED, rotation=_UPSIDE_DOWN).SerializeToString()
        self._vehicles = {
            i: FrameTransform(parent_frame_id=NED, child_frame_id=f"uuv-{i}").SerializeToString()
            for i in range(1, scenario.vehicles + 1)
        }
        self._moves = Template(_transform, 7)

    def message(self, frame: Frame, stamp: bytes) -> bytes:
        """A FrameTransforms message of all vehicles, and of the frames above them; `stamp` is `stamp_field`'s."""
        x, y, z = enu(self._scenario.reference.at(frame.tick * self._scenario.tick_ns / 1e9).position)
        reference = FrameTransform(
            parent_frame_id=MAP,
            child_frame_id=REFERENCE,
            translation=Vector3(x=x, y=y, z=z),
            rotation=NO_TURN,
        )
        found = [field(b"\x0a", stamp + self._ned), field(b"\x0a", stamp + reference.SerializeToString())]
        moves, vehicles = self._moves, self._vehicles
        for row in frame.vehicles:
            x, y, z, theta, psi = row.eta
            turn = quaternion(theta, psi, row.plant[0] if row.plant else 0.0)
            found.append(field(b"\x0a", stamp + vehicles[row.id] + moves(x, y, z, *turn)))
        return b"".join(found)


def _transform(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> FrameTransform:
    """The rest of a transform, by the place of the child's origin and its quaternion."""
    return FrameTransform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def enu(ned: Vec3) -> Vec3:
    """A vector in axes of `ned` in those of `map`."""
    north, east, down = ned
    return east, north, -down


def quaternion(theta: float, psi: float, phi: float = 0.0) -> tuple[float, float, float, float]:
    """(x, y, z, w) of R = Rz(psi) Ry(theta) Rx(phi), body to NED."""
    ct, st, cp, sp = cos(theta / 2), sin(theta / 2), cos(psi / 2), sin(psi / 2)
    x, y, z, w = -sp * st, cp * st, sp * ct, cp * ct
    if not phi:
        return x, y, z, w
    c, s = cos(phi / 2), sin(phi / 2)
    return c * x + s * w, c * y + s * z, c * z - s * y, c * w - s * x


def angles(x: float, y: float, z: float, w: float) -> Vec3:
    """Roll, pitch and heading [rad] of a unit quaternion, body to NED."""
    pitch = asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    roll = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, pitch, atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
