"""The nodes of a scenario whose robots are not ours: where their programs meet us, and what the network carries."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import radians
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, mistake
from netem.endpoint import MOST_ADDRESS

NAME = re.compile(r"(?=.{1,32}$)[A-Za-z][A-Za-z0-9_]*([.-][A-Za-z0-9_]+)*", re.ASCII)
RESERVED = ("all", "bridge", "every", "halves", "isolate", "majority", "one", "ring")  # words where names stand
_TOPICS = ("faults", "link", "run", "scene", "snapshot", "transforms", "uuv")  # first words of topics of the log
_ENDPOINT = re.compile(r"(tcp|tls|udp|quic|ws|unixsock-stream)/\S+", re.ASCII)
LOOPBACK = "127.0.0.1"
_TARGET = re.compile(r"([A-Za-z][\w.-]{0,31})(?::(?:([^\s:]+):)?(\d{1,5}))?", re.ASCII)


def _name(value: Any) -> Any:
    text = str(value)
    if not NAME.fullmatch(text) or text in RESERVED or text in _TOPICS:
        hint = "topics of the log begin with this word" if text in _TOPICS else "as in auv1, auv-1 or auv.1"
        raise mistake(f"expected a name of letters, digits, _, - and ., got {describe_value(value)}", hint=hint)
    return text


def _endpoint(value: Any) -> Any:
    if not isinstance(value, str) or not _ENDPOINT.fullmatch(value):
        raise mistake(f"expected an address of zenoh such as tcp/127.0.0.1:7501, got {describe_value(value)}")
    return value


def _flag(value: Any) -> Any:
    """YAML 1.2 reads yes and no as texts."""
    found = {"yes": True, "no": False}.get(value, value) if isinstance(value, str) else value
    if isinstance(found, str):
        raise mistake(f"expected yes or no, got {describe_value(value)}")
    return found


def _port(value: Any) -> Any:
    if not str(value).isdecimal() or not 0 < int(value) < 65_536:
        raise mistake(f"expected a port from 1 to 65535, got {describe_value(value)}")
    return str(value)


def _open(value: Any, more: str = "") -> Any:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 65_536:
        raise mistake(f"expected a port from 0 to 65535{more}, got {describe_value(value)}", hint="0 is a free one")
    return value


def _open_or_path(value: Any) -> Any:
    if isinstance(value, str) and value.strip() and "\0" not in value:
        return value
    return _open(value, ", or the path of a terminal")


def _target(value: Any) -> Any:
    if not isinstance(value, str) or udp_target(value) is None:
        hint = "datagrams go to addresses of IPv4, or to names that have one" if "[" in str(value) else ""
        what = "expected a node and the port of its program such as auv2:9100"
        raise mistake(f"{what}, got {describe_value(value)}", hint=hint)
    return value


def udp_target(text: str) -> tuple[str, str, int] | None:
    """`auv2:9100` or `auv2:192.168.0.7:9100` as node, host and port; None: it is neither.

    `auv2` alone has port 0: datagrams go to where the last one of the way back came from.
    """
    found = _TARGET.fullmatch(text)
    if found is None or (found[3] is not None and not 0 < int(found[3]) < 65_536):
        return None
    return found[1], found[2] or LOOPBACK, int(found[3] or 0)


class TopicPlace(Section):
    """A place that a topic of ROS 2 says, in CDR: `nav_msgs/Odometry` or `geometry_msgs/PoseStamped`."""

    topic: str


# The languages of modems, and the greatest address of each: the next one of the latter two is everybody's.
LANGUAGES = {"unet": MOST_ADDRESS, "evologics": 254, "micromodem": 126}


MOST_USBL = radians(45.0)  # beyond it the errors of angles are no normal ones


class ModemPortSection(Section):
    """An acoustic modem that programs of the node open, in one of the languages of modems."""

    # TCP ports. 0: a free one, which the run tells, and programs of the file get as {modem}.
    unet: Annotated[int, BeforeValidator(_open)] | None = None  # as UnetStack has 1100
    # A WHOI Micro-Modem: a TCP port, or the path of a pseudo terminal that we make.
    micromodem: Annotated[int | str, BeforeValidator(_open_or_path)] | None = None
    evologics: Annotated[int, BeforeValidator(_open)] | None = None  # as EvoLogics has 9200; experimental
    mode: Literal["data", "command"] | None = None  # of EvoLogics, in which a connection begins; None: data
    usbl: v.Angle | None = None  # of EvoLogics: it measures where sounds come from, with this standard deviation
    host: str = LOOPBACK  # the address that it listens on
    address: Annotated[int, Field(ge=1, le=MOST_ADDRESS)] | None = None  # in the water; None: the number of the node

    @property
    def language(self) -> str:
        """The key that says its language: the first one that is given."""
        return next((name for name in LANGUAGES if getattr(self, name) is not None), next(iter(LANGUAGES)))

    @property
    def where(self) -> int | str | None:
        """The port, or the path of the terminal."""
        found: int | str | None = getattr(self, self.language)
        return found


class Node(Section):
    """A robot that is not ours: its programs connect to an address of ours, or we join a router of theirs."""

    listen: Annotated[str, BeforeValidator(_endpoint)] | None = None
    connect: Annotated[str, BeforeValidator(_endpoint)] | None = None
    zenoh: str | None = None  # a file of zenoh's configuration, for TLS and credentials
    # Datagrams to our port leave for a program of another node: "9000": auv2:9100, or auv2:HOST:9100, or auv2.
    udp: dict[Annotated[str, BeforeValidator(_port)], Annotated[str, BeforeValidator(_target)]] = {}
    host: str = LOOPBACK  # the address of this machine on which its ports of `udp` are; 0.0.0.0: all
    modem: ModemPortSection | None = None
    isolate: Annotated[bool, BeforeValidator(_flag)] = False  # its programs are in a network namespace of their own
    place: TopicPlace | v.Position | None = None  # NED; in ROS topics ENU


def without_address(nodes: Mapping[str, Node]) -> list[str]:
    """The nodes that say no address. Each gets a router of ours at a free port of this host."""
    receives = {text.partition(":")[0] for node in nodes.values() for text in node.udp.values()}

    def has_none(name: str, node: Node) -> bool:
        modem_alone = node.modem is not None and not isinstance(node.place, TopicPlace)
        return not (node.listen or node.connect or node.udp or node.isolate or name in receives or modem_alone)

    return [name for name, node in nodes.items() if has_none(name, node)]


NodeName = Annotated[str, BeforeValidator(_name)]
Flag = Annotated[bool, BeforeValidator(_flag)]
