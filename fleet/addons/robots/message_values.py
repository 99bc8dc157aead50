"""Numbers in messages of programs that are not ours: in JSON, MessagePack, CBOR, types of ROS 2, or plain bytes."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from typing import Any

import msgpack

from fleet.addons.robots.ros2.rmw import read_key
from fleet.addons.robots.ros2.types import types_of
from fleet.errors import FleetError
from fleet.scenario.schema.programs import StackSignalSection

_STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(-?\d{1,9})\]", re.ASCII)
_STRUCT = re.compile(r"([@=<>!]?[\dcbB?hHiIlLqQnNefdspPx\s]+)(?:\[(\d{1,6})\])?", re.ASCII)


class NoNumber(FleetError):
    """A message has no number where the signal looks for it."""


def path_of(text: str) -> list[str | int]:
    """The steps of a path such as `[0][2]` or `pose.position.x`; none: the whole value. Raises NoNumber: it is none."""
    steps: list[str | int] = []
    end = 0
    for found in _STEP.finditer(text):
        if found.start() != end:
            break
        steps.append(found[1] if found[1] is not None else int(found[2]))
        end = found.end()
    if end != len(text):
        raise NoNumber(f"expected a path such as [0][2] or pose.x, got {text:.80}")
    return steps


def number_at(value: Any, path: list[str | int]) -> float:
    """The number at a path. Raises NoNumber: there is none."""
    for step in path:
        try:
            value = value[step] if isinstance(step, int) or isinstance(value, dict) else getattr(value, step)
        except (KeyError, IndexError, TypeError, AttributeError):
            raise NoNumber(f"there is no {step}") from None
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise NoNumber(f"expected a number, got {value!r:.40}") from None


def reader(section: StackSignalSection) -> Callable[[str, bytes], float]:
    """The function that finds the number of a signal in a message, by its key and its payload.

    The function raises NoNumber: the message has none.

    Raises:
        NoNumber: the section describes none.
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
        raise NoNumber("is CBOR, which needs: pip install cbor2") from None
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
    found = _STRUCT.fullmatch(text)
    try:
        layout = struct.Struct(found[1] if found else "")
    except struct.error as error:
        raise NoNumber(f"expected a format such as <Hf[1], got {text:.40} ({error})") from None
    if found is None or not layout.size or layout.size > 65_536:
        raise NoNumber(f"expected a format such as <Hf[1], got {text:.40}")
    which = int(found[2] or 0)

    def read(_: str, payload: bytes) -> float:
        if len(payload) < layout.size:
            raise NoNumber(f"has {len(payload)} bytes, and {text} needs {layout.size}")
        return number_at(layout.unpack_from(payload), [which])

    return read
