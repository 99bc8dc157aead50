"""Message classes of ROS 2 for programs, as rclpy's generated ones: each field has a default and can be set."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from fleet.addons.robots.ros2.types import RosTypes, types_of

# Services that rosbags has no definitions of.
_SERVICES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message\n",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
    "example_interfaces/srv/AddTwoInts": "int64 a\nint64 b\n---\nint64 sum\n",
}
_MESSAGES = {
    f"example_interfaces/msg/{name}": f"{kind} data\n"
    for name, kind in {
        "Bool": "bool",
        "Int32": "int32",
        "Int64": "int64",
        "Float64": "float64",
        "String": "string",
    }.items()
}


@cache
def known_types() -> RosTypes:
    """The types of the usual distribution, with some of its examples. Raises FleetError: the extra is not there."""
    types = types_of()
    for name, text in _SERVICES.items():
        types.add_service(name, text)
    for name, text in _MESSAGES.items():
        types.add_message(name, text)
    return types


class RosMessage:
    """A message. Its class has `name`, such as `std_msgs/msg/String`, and `fields`, with the maker of each default."""

    name: ClassVar[str] = ""
    fields: ClassVar[dict[str, Any]] = {}

    def __init__(self, **values: Any) -> None:
        if unknown := values.keys() - self.fields.keys():
            raise AttributeError(f"{self.name} has no field {min(unknown)!r}; it has {', '.join(self.fields)}")
        for field, make in self.fields.items():
            setattr(self, field, values[field] if field in values else make())

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.fields:
            raise AttributeError(f"{self.name} has no field {name!r}; it has {', '.join(self.fields)}")
        object.__setattr__(self, name, value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RosMessage) and self.name == other.name and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"{self.name.replace('/', '.')}({', '.join(f'{k}={v!r}' for k, v in vars(self).items())})"

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """The names of the fields."""
        return dict.fromkeys(cls.fields, "")


@cache
def message_class(name: str) -> type[RosMessage]:
    """The class of a type, such as `geometry_msgs/msg/Twist`. Raises KeyError: nobody knows the type."""
    constants, fields = known_types().store.fielddefs[name]
    made: Any = type(name.rpartition("/")[2], (RosMessage,), {"name": name, "fields": {}})
    for constant, _, value in constants:
        setattr(made, constant, value)
    made.fields = {field: _default(kind) for field, kind in fields}
    return made  # type: ignore[no-any-return]


def _default(kind: Any) -> Any:
    """What makes the default of a field, by its type as rosbags describes it."""
    node, about = int(kind[0]), kind[1]
    if node == 1:  # a base type
        base = about[0]
        return {"string": str, "wstring": str, "bool": bool, "float32": float, "float64": float}.get(base, int)
    if node == 2:  # another message
        return lambda: message_class(about)()
    inner, size = about[0], about[1] if node == 3 else 0
    one = _default(inner)
    return lambda: [one() for _ in range(size)]


def to_cdr(message: RosMessage) -> bytes:
    """The bytes of a message. Raises TypeError, ValueError: a field has a value of another type."""
    return known_types().encode(message.name, _plain(message))


def from_cdr(name: str, data: bytes) -> RosMessage:
    """A message from its bytes. Raises ValueError: they are none of it."""
    return _rich(known_types().decode(name, data), name)


def _plain(message: RosMessage) -> Any:
    _, fields = known_types().store.fielddefs[message.name]
    values = {field: _packed(getattr(message, field), kind) for field, kind in fields}
    return known_types().new(message.name, **values)


_ARRAYS = {"bool": np.bool_, "byte": np.uint8, "char": np.uint8, "float32": np.float32, "float64": np.float64} | {
    f"{sign}int{bits}": np.dtype(f"{sign}int{bits}").type for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def _packed(value: Any, kind: Any) -> Any:
    node, about = int(kind[0]), kind[1]
    if node == 1:
        return value
    if node == 2:
        return _plain(value)
    inner = about[0]
    if int(inner[0]) == 1 and inner[1][0] in _ARRAYS:
        return np.asarray(list(value) if not isinstance(value, bytes) else bytearray(value), _ARRAYS[inner[1][0]])
    return [_packed(each, inner) for each in value]


def _rich(found: Any, name: str) -> RosMessage:
    _, fields = known_types().store.fielddefs[name]
    return message_class(name)(**{field: _unpacked(getattr(found, field), kind) for field, kind in fields})


def _unpacked(value: Any, kind: Any) -> Any:
    node, about = int(kind[0]), kind[1]
    if node == 1:
        return value
    if node == 2:
        return _rich(value, about)
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_unpacked(each, about[0]) for each in value]


def interface_module(name: str) -> ModuleType:
    """A module such as `std_msgs.msg` or `std_srvs.srv`, whose classes are made when they are asked for."""
    package, _, kind = name.partition(".")

    def __getattr__(each: str) -> Any:  # noqa: N807
        whole = f"{package}/{kind}/{each}"
        if each.startswith("_"):
            raise AttributeError(each)
        try:
            if kind == "srv":
                parts = {part: message_class(f"{whole}_{part}") for part in ("Request", "Response")}
                made: Any = type(each, (), {"name": whole, **parts})
            else:
                made = message_class(whole)
        except KeyError:
            raise AttributeError(f"{whole} is no type that is known here; fleet netem runs the node with ROS") from None
        setattr(module, each, made)
        return made

    module = ModuleType(name)
    vars(module).update(__getattr__=__getattr__)
    return module
