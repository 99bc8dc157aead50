"""Numbers in messages of programs that are not ours: in JSON, MessagePack, CBOR, types of ROS 2, or plain bytes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import msgpack

from fleet.addons.robots.ros2.rmw import read_key
from fleet.addons.robots.ros2.types import types_of
from fleet.errors import FleetError
from fleet.scenario.schema.programs import StackSignalSection, path_of, struct_of
from world.plugins.fence import shown


class NoNumber(FleetError):
    """A message has no number where the signal looks for it."""


def number_at(value: Any, path: list[str | int]) -> float:
    """The number at a path. Raises NoNumber: there is none."""
    for step in path:
        try:
            if isinstance(step, str) and is_dataclass(value):  # a message of ROS 2
                value = {each.name: getattr(value, each.name) for each in fields(value)}
            value = value[step]
        except (KeyError, IndexError, TypeError):
            raise NoNumber(f"there is no {step}") from None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise NoNumber(f"expected a number, got {shown(value):.40}") from None


def reader(section: StackSignalSection) -> Callable[[str, bytes], float]:
    """The function that finds the number of a signal in a message, by its key and its payload.

    The function raises NoNumber: the message has none.
    """
    ((kind, text),) = section.formats
    if kind == "struct":
        return _of_struct(text)
    path = path_of(text)
    if kind == "ros":
        return lambda key, payload: number_at(_of_ros(key, payload), path)
    decode: Callable[[bytes], Any] = _DECODERS[kind]

    def read(_: str, payload: bytes) -> float:
        try:
            value = decode(payload)
        except NoNumber:
            raise
        except Exception as error:  # a library that decodes a stranger's bytes may raise anything
            raise NoNumber(f"is not {kind}: {error!s:.80}") from None
        return number_at(value, path)

    return read


def _of_msgpack(payload: bytes) -> Any:
    return msgpack.unpackb(payload, strict_map_key=False)


def _of_cbor(payload: bytes) -> Any:
    try:
        import cbor2
    except ImportError:
        raise NoNumber("is CBOR, which needs uuv-fleet[cbor]") from None
    return cbor2.loads(payload)


def _of_ros(key: str, payload: bytes) -> Any:
    entity = read_key(key)
    if entity is None:
        raise NoNumber(f"{key:.80} is no topic of ROS 2")
    try:
        return types_of().decode(entity.type, payload)
    except ValueError as error:
        raise NoNumber(f"{key:.80}: {error!s:.80}") from None


_DECODERS: dict[str, Callable[[bytes], Any]] = {"json": json.loads, "msgpack": _of_msgpack, "cbor": _of_cbor}


def _of_struct(text: str) -> Callable[[str, bytes], float]:
    found = struct_of(text)
    assert found is not None  # the schema has read it
    layout, which = found

    def read(_: str, payload: bytes) -> float:
        if len(payload) < layout.size:
            raise NoNumber(f"has {len(payload)} bytes, and {text} needs {layout.size}")
        return number_at(layout.unpack_from(payload), [which])

    return read
