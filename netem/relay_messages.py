"""What the console and the process of the relay tell each other, over a pipe."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from netem.config import NetemConfig
from netem.relay import MessageFate
from netem.wire.robots import RobotEndpoint


class Port(Struct, frozen=True):
    """Datagrams that a program of `src` sends to our port, and where they leave to."""

    src: int
    port: int
    dst: int
    host: str
    to: int  # 0: to the sender of the last datagram of the way back
    at: str = "127.0.0.1"  # the address of this machine on which our port is


class Watched(Struct, frozen=True):
    """Something of a robot that the console wants to know, whether the network carries it or not."""

    robot: int
    key: str  # a key expression of zenoh, or `udp/PORT` for the datagrams of one of our ports
    token: bool = False  # a liveliness token, and not a message


class Setup(Struct):
    """The settings of the process; they are pickled."""

    config: NetemConfig
    robots: tuple[RobotEndpoint, ...]
    carry: tuple[str, ...]
    ports: tuple[Port, ...] = ()
    places: dict[int, tuple[float, ...]] = {}
    place_topics: dict[int, str] = {}
    header: int = 0
    fragments: bool = False
    payloads: bool = False
    linked: bool = False  # discovery
    lost_after_ns: int = 0
    watched: tuple[Watched, ...] = ()
    modems: tuple[Any, ...] = ()  # modems that programs open: each a `ModemEndpoint`
    isolated: tuple[int, ...] = ()  # robots whose programs are in a network namespace of their own
    ticks: int = 2**62  # the length of the run, if the console does not end it


class LoggedMessage(Struct):
    """A message as its robot sent it, for the log."""

    tick: int
    src: int
    key: str
    kind: str
    encoding: str
    payload: bytes


class Opened(Struct):
    """The first thing that the console hears."""

    ports: dict[int, int] = {}  # by robot whose address leaves its port open: the port of our router
    modems: dict[int, str] = {}  # by robot: the port of its modem, or the path of its terminal
    namespaces: dict[int, tuple[str, ...]] = {}  # by robot: the files that its programs enter, in this order
    problem: str = ""  # why the relay cannot begin


class WatchedMessage(Struct):
    """A message or token that the console wants to know."""

    which: int  # place among those that are watched
    at_ns: int
    key: str
    payload: bytes = b""


class RelayReport(Struct):
    """The events up to a tick."""

    until: int  # below 0: of the time in which programs get ready
    fates: list[MessageFate]
    messages: list[LoggedMessage] = []
    placed: list[tuple[int, str, bytes]] = []  # robot, key, and message of a topic that says where it is
    notes: list[str] = []
    watched: list[WatchedMessage] = []
    closing: dict[str, Any] | None = None  # with the last report: counts and lateness
