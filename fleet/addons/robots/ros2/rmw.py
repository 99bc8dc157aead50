"""Names on the wire as rmw_zenoh has them: keys of topics and services, liveliness tokens, attachments.

Written from the design page of rmw_zenoh (`docs/design.md` in github.com/ros2/rmw_zenoh). A token announces an entity
to others. An attachment goes with every message, and a subscriber drops a message without one.
"""

from __future__ import annotations

import os
import re
from struct import Struct
from typing import Literal, NamedTuple

from fleet.addons.robots.ros2.types import dds_name, ros_name
from fleet.errors import FleetError

MOST_DOMAIN = 232  # with DDS a larger one has no ports
TOKENS = "@ros2_lv"
EntityKind = Literal["MP", "MS", "SS", "SC"]  # publisher, subscription, server and client of a service
_ATTACHMENT = Struct("<qqB16s")
_GID_BYTES = 16
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)


class Qos(NamedTuple):
    """Quality of service; what is left out is what ROS has by default."""

    depth: int = 10
    best_effort: bool = False
    transient_local: bool = False

    def __str__(self) -> str:
        return f"{'2' if self.best_effort else ''}:{'1' if self.transient_local else ''}:,{self.depth}:,:,:,,"


DEFAULT = Qos()
SENSOR = Qos(depth=5, best_effort=True)  # rmw_qos_profile_sensor_data
LATCHED = Qos(depth=1, transient_local=True)


class RmwAttachment(NamedTuple):
    """The data that rmw_zenoh sends beside each message, request or answer."""

    sequence: int  # from 1
    sent_ns: int  # since 1970
    gid: bytes  # of the publisher, or of the client of a service: 16 bytes


class Entity(NamedTuple):
    """A publisher, a subscription, or one side of a service."""

    domain: int
    name: str  # of the topic or service, `/uuv_1/odom`
    type: str  # `nav_msgs/msg/Odometry`
    hash: str

    @property
    def key(self) -> str:
        return f"{self.domain}/{self.name.strip('/')}/{dds_name(self.type)}/{self.hash}"

    def token(self, session: str, node: str, number: int, kind: EntityKind, qos: Qos = DEFAULT) -> str:
        """The key of its liveliness token. `session`: zenoh's id of the session. `node`: name of the node, which has
        number 0 and no namespace. `number`: of the entity, from 1."""
        who = f"{TOKENS}/{self.domain}/{session}/0/{number}/{kind}/%/%/{node}"
        return f"{who}/{self.name.replace('/', '%')}/{dds_name(self.type)}/{self.hash}/{qos}"


def node_token(domain: int, session: str, node: str) -> str:
    return f"{TOKENS}/{domain}/{session}/0/0/NN/%/%/{node}"


def read_key(key: str) -> Entity | None:
    """The topic or service of a key; None: it is none of rmw_zenoh."""
    domain, _, rest = key.partition("/")
    parts = rest.rsplit("/", 2)
    if len(parts) != 3 or not domain.isdecimal() or len(domain) > 3:
        return None
    name = ros_name(parts[1])
    return None if name is None else Entity(int(domain), f"/{parts[0]}", name, parts[2])


def read_token(token: str) -> tuple[str, str, Entity] | None:
    """Node, kind and entity of a liveliness token; None: it is that of a node, or none of rmw_zenoh.

    Later versions may put more behind it.
    """
    parts = token.split("/")
    if len(parts) < 13 or parts[0] != TOKENS or parts[5] not in ("MP", "MS", "SS", "SC"):
        return None
    name = ros_name(parts[10])
    if name is None or not parts[1].isdecimal() or len(parts[1]) > 3:
        return None
    return parts[8], parts[5], Entity(int(parts[1]), parts[9].replace("%", "/"), name, parts[11])


def pack(attachment: RmwAttachment) -> bytes:
    return _ATTACHMENT.pack(attachment.sequence, attachment.sent_ns, _GID_BYTES, attachment.gid)


def unpack(data: bytes | None) -> RmwAttachment:
    """The inverse of `pack`. Raises ValueError: it is none, or of rmw_zenoh before 0.2.4."""
    if data is None:
        raise ValueError("a message without an attachment, which rmw_zenoh always has")
    if len(data) != _ATTACHMENT.size or data[16] != _GID_BYTES:
        raise ValueError(f"an attachment of {len(data)} bytes; rmw_zenoh has 33 of them since 0.2.4 (2025-04)")
    sequence, sent_ns, _, gid = _ATTACHMENT.unpack(data)
    return RmwAttachment(sequence, sent_ns, gid)


def gid_of(token: str) -> bytes:
    """The id of an entity: XXH3 of its token, 128 bits, the lower half first."""
    import xxhash

    high, low = divmod(int(xxhash.xxh3_128_intdigest(token.encode())), 1 << 64)
    return low.to_bytes(8, "little") + high.to_bytes(8, "little")


def domain_of(asked: int | None) -> int:
    """The domain: the given one, else ROS_DOMAIN_ID, else 0. Raises FleetError: it is none."""
    text = os.environ.get("ROS_DOMAIN_ID", "") if asked is None else str(asked)
    if not text:
        return 0
    if not text.isdecimal() or int(text) > MOST_DOMAIN:
        raise FleetError(f"a domain of ROS is a number from 0 to {MOST_DOMAIN}, got {text!r:.40}")
    return int(text)


def check_name(name: str) -> str:
    """A name of a topic with all its namespaces. Raises FleetError: it is none."""
    if not _NAME.fullmatch(name):
        raise FleetError(f"a topic of ROS has a name such as /uuv_1/odom, got {name!r:.80}")
    return name
