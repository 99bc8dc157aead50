"""A log that was not written by this program."""

from __future__ import annotations

import json
from pathlib import Path

from google.protobuf import struct_pb2
from mcap.writer import Writer

from fleet.logs.schemas import MessageField, _descriptor_set, flat_schema


def foreign(path: Path) -> Path:
    """A log of somebody else's: JSON, a schema that is none, protobuf of any shape."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        words = writer.register_channel("words", "json", 0)
        broken = writer.register_channel("broken", "protobuf", writer.register_schema("No", "protobuf", b"\xff\xff"))
        ragged = flat_schema("Ragged", (MessageField("values", "V", "some", 1), MessageField("more", "A", "one")))
        odd = writer.register_channel(
            "odd", "protobuf", writer.register_schema(ragged.name, "protobuf", ragged.descriptor_set)
        )
        tree = writer.register_schema(
            "google.protobuf.Struct", "protobuf", _descriptor_set(struct_pb2.Struct.DESCRIPTOR.file)
        )
        nested = writer.register_channel("nested", "protobuf", tree)
        for k in range(3):
            writer.add_message(words, k, json.dumps({"k": k}).encode(), k)
            writer.add_message(broken, k, b"?", k)
            writer.add_message(odd, k, ragged.message(values=[1.0] * k, more=k).SerializeToString(), k)
            told = struct_pb2.Struct()
            told.update({"k": k})
            writer.add_message(nested, k, told.SerializeToString(), k)
        writer.finish()
    return path
