"""A template gives what protobuf gives, of any doubles."""

from __future__ import annotations

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import given
from hypothesis import strategies as st

from fleet.recorder.template import Template, field

REALS = st.one_of(st.floats(), st.sampled_from([0.0, -0.0]))
NAMES = st.text(max_size=200)


def transform(x: float, y: float, z: float) -> FrameTransform:
    return FrameTransform(parent_frame_id="ned", child_frame_id="uuv", translation=Vector3(x=x, y=y, z=z))


TEMPLATE = Template(transform, 3)


@given(st.tuples(REALS, REALS, REALS))
def test_the_bytes_are_those_of_protobuf(values: tuple[float, float, float]) -> None:
    assert TEMPLATE(*values) == transform(*values).SerializeToString()


@given(NAMES, NAMES)
def test_a_field_of_joined_messages_is_one_message(parent: str, child: str) -> None:
    parts = FrameTransform(parent_frame_id=parent), FrameTransform(child_frame_id=child)
    whole = FrameTransforms(transforms=[FrameTransform(parent_frame_id=parent, child_frame_id=child)])
    assert field(b"\x0a", b"".join(part.SerializeToString() for part in parts)) == whole.SerializeToString()
