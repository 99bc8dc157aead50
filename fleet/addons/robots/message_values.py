"""Numbers in messages of programs that are not ours: those of programs in simulated time, and types of ROS 2."""

from __future__ import annotations

from typing import Any

from fleet.addons.programs.message_signal import NoNumber, Reader, number_at, plain_reader
from fleet.addons.robots.ros2.rmw import read_key
from fleet.addons.robots.ros2.types import types_of
from fleet.scenario.schema.programs import StackSignalSection, path_of


def reader(section: StackSignalSection) -> Reader:
    """The function that finds the number of a signal in a message, by its key and its payload."""
    ((kind, text),) = section.formats
    if kind != "ros":
        return plain_reader(kind, text)
    path = path_of(text)
    return lambda key, payload: number_at(_decode_ros(key, payload), path)


def _decode_ros(key: str, payload: bytes) -> Any:
    entity = read_key(key)
    if entity is None:
        raise NoNumber(f"{key:.80} is no topic of ROS 2")
    try:
        return types_of().decode(entity.type, payload)
    except ValueError as error:
        raise NoNumber(f"{key:.80}: {error!s:.80}") from None
