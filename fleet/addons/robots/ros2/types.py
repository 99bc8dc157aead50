"""Types of ROS 2: their classes, their bytes (CDR) and their hashes, without ROS; `rosbags` has the definitions.

Types of our own are in the package `uuv_fleet_msgs` beside this file, as ROS builds them.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from fleet.errors import FleetError
from fleet.logs.table import require

DISTRIBUTIONS = ("humble", "jazzy", "kilted")
USUAL = "jazzy"
NO_HASH = "TypeHashNotSupported"  # what rmw_zenoh of Humble puts where later ones have the hash
OWN = "uuv_fleet_msgs"
INTERFACES = Path(__file__).parent / OWN
_EVENT = "service_msgs/ServiceEventInfo info\n{0}_Request[<=1] request\n{0}_Response[<=1] response\n"
_SERVICE = "{0}_Request request_message\n{0}_Response response_message\n{0}_Event event_message\n"
# Not shipped with rosbags, or with `char`, which ROS takes for uint8 and rosbags does not.
_EVENT_INFO = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number\n"


def types_of(distribution: str = USUAL) -> RosTypes:
    """The types of a distribution of ROS 2. Raises FleetError: the extra `ros2` is not installed."""
    require("ROS 2", ("rosbags", "xxhash"), "ros2")
    return _types_of(distribution)


@cache
def _types_of(distribution: str) -> RosTypes:
    return RosTypes(distribution)


class RosTypes:
    """The types of one distribution; names are such as `nav_msgs/msg/Odometry`."""

    def __init__(self, distribution: str) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.distribution = distribution
        self.store = get_typestore(Stores(f"ros2_{distribution}"))
        self._hashes: dict[str, str] = {}
        self._register("service_msgs/msg/ServiceEventInfo", _EVENT_INFO)
        for path in sorted(INTERFACES.glob("msg/*.msg")):
            self._register(f"{OWN}/msg/{path.stem}", path.read_text("utf-8"))
        for path in sorted(INTERFACES.glob("srv/*.srv")):
            self.add_service(f"{OWN}/srv/{path.stem}", path.read_text("utf-8"))

    def add_service(self, name: str, text: str) -> None:
        """A service type, such as `std_srvs/srv/Trigger`, by its definition: request, `---`, response."""
        request, _, response = f"\n{text}".partition("\n---\n")  # a line, and no end of a comment
        self._register(f"{name}_Request", request)
        self._register(f"{name}_Response", response)
        self._register(f"{name}_Event", _EVENT.format(name))
        self._register(name, _SERVICE.format(name))

    def _register(self, name: str, text: str) -> None:
        """A type by its definition; rosbags knows messages only, and reads those of services when they are told so."""
        from rosbags.typesys import get_types_from_msg

        ((_, (constants, fields)),) = get_types_from_msg(text, name).items()
        known = self.store.fielddefs
        if name in known:  # a definition that is amended
            del known[name]
        self.store.register({name: (constants, [(field, _with_type_names(kind)) for field, kind in fields])})

    def new(self, name: str, /, **fields: Any) -> Any:
        """A message of a type. Raises TypeError: it has other fields."""
        return self.store.types[name](**fields)

    def hash(self, name: str) -> str:
        """The type hash in keys of rmw_zenoh (REP 2016), which Humble does not have. Raises FleetError: the type is not
        known."""
        if self.distribution == "humble":
            return NO_HASH
        if name not in self._hashes:
            if name not in self.store.fielddefs:
                raise FleetError(f"{name} is no type that is known of {self.distribution}")
            self._hashes[name] = self.store.hash_rihs01(name)
        return self._hashes[name]

    def encode(self, name: str, message: Any) -> bytes:
        """A message as CDR, little endian, with its header of four bytes."""
        return bytes(self.store.serialize_cdr(message, name))

    def decode(self, name: str, data: bytes) -> Any:
        """The inverse. Raises ValueError: it is no such message."""
        try:
            return self.store.deserialize_cdr(data, name)
        except Exception as error:  # rosbags raises half a dozen unrelated types for bad bytes
            raise ValueError(f"{len(data)} bytes that are no {name} in CDR ({type(error).__name__})") from None

    def definition(self, name: str) -> str:
        """The text of a message type and of the types that it consists of, as a bag holds it."""
        return str(self.store.generate_msgdef(name, ros_version=2)[0])


def dds_name(name: str) -> str:
    """`nav_msgs::msg::dds_::Odometry_` of `nav_msgs/msg/Odometry`."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def ros_name(dds: str) -> str | None:
    """The inverse; None: it is no such name."""
    parts = dds.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def _with_type_names(kind: Any) -> Any:
    """A field's type, with the names of types of services as they are: rosbags puts `msg` into them, and takes a name
    without a package for one of the folder `srv`."""
    if isinstance(kind, str):
        of_service = kind.endswith(("_Request", "_Response", "_Event"))
        return kind.replace("/srv/msg/", "/srv/" if of_service else "/msg/")
    return tuple(map(_with_type_names, kind)) if isinstance(kind, tuple) else kind
