"""Message classes of ROS 2 for programs, as rclpy's generated ones: each field has a default and can be set."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from fleet.addons.robots.ros2.types import RosTypes, types_of

Definitions = tuple[tuple[str, str], ...]  # names, such as `std_srvs/srv/Trigger`, and texts
# Packages of ROS that rosbags has no definitions of.
_EXAMPLES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message\n",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
    "example_interfaces/srv/AddTwoInts": "int64 a\nint64 b\n---\nint64 sum\n",
    **{
        f"example_interfaces/msg/{kind.capitalize()}": f"{kind} data\n"
        for kind in ("bool", "int32", "int64", "float64", "string")
    },
}


class RosMessage:
    """A message. Its class has `name`, such as `std_msgs/msg/String`, `interfaces`, which know it, and `fields`, with
    the maker of each default.
    """

    name: ClassVar[str] = ""
    interfaces: ClassVar[Interfaces]
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


class Interfaces:
    """The messages and services that a program knows: of the usual distribution, of some examples, and its own."""

    def __init__(self, own: Definitions) -> None:
        """Read the definitions. Raises FleetError: the extra is not there."""
        self.types = RosTypes(types_of().distribution)  # not those that others use, since some are added
        self._made: dict[str, type[RosMessage]] = {}
        for name, text in (*_EXAMPLES.items(), *own):
            add = self.types.add_service if "/srv/" in name else self.types.add_message
            add(name, text)

    def message_class(self, name: str) -> type[RosMessage]:
        """The class of a type, such as `geometry_msgs/msg/Twist`; all programs share those that are not their own.

        Raises KeyError: nobody knows the type.
        """
        usual = interfaces()
        if self is not usual and name in usual.types.store.fielddefs:
            return usual.message_class(name)
        if name not in self._made:
            constants, fields = self.types.store.fielddefs[name]
            values = {constant: value for constant, _, value in constants}
            makers = {field: self._default(kind) for field, kind in fields}
            values |= {"name": name, "interfaces": self, "fields": makers}
            self._made[name] = type(name.rpartition("/")[2], (RosMessage,), values)
        return self._made[name]

    def service_class(self, name: str) -> type:
        """The class of a service, such as `std_srvs/srv/Trigger`. Raises KeyError: nobody knows it."""
        parts = {part: self.message_class(f"{name}_{part}") for part in ("Request", "Response")}
        return type(name.rpartition("/")[2], (), {"name": name, **parts})

    def _default(self, kind: Any) -> Any:
        """What makes the default of a field, by its type as rosbags describes it."""
        node, about = int(kind[0]), kind[1]
        if node == 1:  # a base type
            base = about[0]
            return {"string": str, "wstring": str, "bool": bool, "float32": float, "float64": float}.get(base, int)
        if node == 2:  # another message
            return lambda: self.message_class(about)()
        inner, size = about[0], about[1] if node == 3 else 0
        one = self._default(inner)
        return lambda: [one() for _ in range(size)]

    def rich(self, found: Any, name: str) -> RosMessage:
        """A message as a program has it, of one of rosbags."""
        _, fields = self.types.store.fielddefs[name]
        values = {field: self._unpacked(getattr(found, field), kind) for field, kind in fields}
        return self.message_class(name)(**values)

    def _unpacked(self, value: Any, kind: Any) -> Any:
        node, about = int(kind[0]), kind[1]
        if node == 1:
            return value
        if node == 2:
            return self.rich(value, about)
        if isinstance(value, np.ndarray):
            return value.tolist()
        return [self._unpacked(each, about[0]) for each in value]


@cache
def interfaces(own: Definitions = ()) -> Interfaces:
    """The types that programs with some definitions of their own know. Raises FleetError: the extra is not there."""
    return Interfaces(own)


def to_cdr(message: RosMessage) -> bytes:
    """The bytes of a message. Raises TypeError, ValueError: a field has a value of another type."""
    return message.interfaces.types.encode(message.name, _plain(message))


def from_cdr(kind: type[RosMessage], data: bytes) -> RosMessage:
    """A message of a class from its bytes. Raises ValueError: they are none of it."""
    return kind.interfaces.rich(kind.interfaces.types.decode(kind.name, data), kind.name)


def _plain(message: RosMessage) -> Any:
    types = message.interfaces.types
    _, fields = types.store.fielddefs[message.name]
    return types.new(message.name, **{field: _packed(getattr(message, field), kind) for field, kind in fields})


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


def interface_module(package: str, kind: str, own: Definitions) -> ModuleType:
    """A module such as `std_msgs.msg` or `std_srvs.srv`, whose classes are made when they are asked for.

    Args:
        package: of the messages or services.
        kind: `msg` or `srv`.
        own: definitions of the program's own.

    Returns:
        The module.
    """
    known = interfaces(own)
    make = known.service_class if kind == "srv" else known.message_class

    def __getattr__(each: str) -> Any:  # noqa: N807
        whole = f"{package}/{kind}/{each}"
        if each.startswith("_"):
            raise AttributeError(each)
        try:
            made = make(whole)
        except KeyError:
            raise AttributeError(f"{whole} is no type that is known here; fleet netem runs the node with ROS") from None
        setattr(module, each, made)
        return made

    module = ModuleType(f"{package}.{kind}")
    vars(module).update(__getattr__=__getattr__)
    return module
