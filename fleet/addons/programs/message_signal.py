"""Numbers in messages of programs: in JSON, MessagePack, CBOR, or plain bytes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import msgpack

from fleet.errors import FleetError
from fleet.scenario.schema.programs import path_of, struct_of
from world.plugins.fence import show_value

Reader = Callable[[str, bytes], float]  # of a message, by its key and its payload; raises NoNumber: it has none


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
        raise NoNumber(f"expected a number, got {show_value(value):.40}") from None


def plain_reader(kind: str, text: str) -> Reader:
    """The function that finds a number in messages.

    Args:
        kind: their format: json, msgpack, cbor or struct.
        text: where the number is in them.
    """
    if kind == "struct":
        return _struct_reader(text)
    path = path_of(text)
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


def _decode_msgpack(payload: bytes) -> Any:
    return msgpack.unpackb(payload, strict_map_key=False)


def _decode_cbor(payload: bytes) -> Any:
    try:
        import cbor2
    except ImportError:
        raise NoNumber("is CBOR, which needs uuv-fleet[cbor]") from None
    return cbor2.loads(payload)


_DECODERS: dict[str, Callable[[bytes], Any]] = {"json": json.loads, "msgpack": _decode_msgpack, "cbor": _decode_cbor}


def _struct_reader(text: str) -> Callable[[str, bytes], float]:
    found = struct_of(text)
    assert found is not None  # the schema has read it
    layout, which = found

    def read(_: str, payload: bytes) -> float:
        if len(payload) < layout.size:
            raise NoNumber(f"has {len(payload)} bytes, and {text} needs {layout.size}")
        return number_at(layout.unpack_from(payload), [which])

    return read


@dataclass(frozen=True, slots=True)
class MessageSignal:
    """A signal that messages of a program tell."""

    name: str
    matches: Callable[[str], bool]  # whether a key is that of such a message
    number: Reader | None  # None: the value is the number of such messages

    @property
    def counts(self) -> bool:
        """Whether it counts messages."""
        return self.number is None

    def read(self, key: str, payload: bytes, before: float | None) -> float | None:
        """The value after a message; None: it is another one's. Raises NoNumber: it has none.

        Args:
            key: on which it was put, or `udp/PORT`.
            payload: the message.
            before: the value so far.
        """
        if not self.matches(key):
            return None
        return (before or 0.0) + 1.0 if self.number is None else self.number(key, payload)
