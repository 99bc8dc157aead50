"""Every message of a run, declared once: field, unit, one-line meaning.

A message is a MessagePack array `[kind, field, field, ...]` in the declared order. The encoder, the strict
decoder and the protocol page (`fleet protocol`) all follow from the declarations in this file.

Integers are unsigned; reals are IEEE-754 doubles (an integer is accepted where a real is expected, because
some languages' MessagePack writes 1.0 as 1). Ticks count control periods Ts from the start of the run.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

import msgspec

from netem.errors import MalformedMessage

PROTOCOL_VERSION = 1

Reals = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Field:
    """The declaration of one field: unit ("" when it has none), meaning, wire type.

    A wire type is uint, bool, str, bin, a record's name, real[n] or real[*] (of any number), or an array of one of
    them, marked by another [*]. Reals must be finite unless said otherwise.
    """

    unit: str
    meaning: str
    wire: str
    finite: bool = True


def fields_of(cls: type) -> dict[str, Field]:
    """The declared fields of a message or record, in wire order."""
    found = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        found[name] = next(a for a in get_args(hint) if isinstance(a, Field))
    return found


def uint(unit: str, meaning: str) -> Field:
    return Field(unit, meaning, "uint")


def real(unit: str, meaning: str, size: int | None, *, finite: bool = True) -> Field:
    return Field(unit, meaning, f"real[{'*' if size is None else size}]", finite)


class _InvalidError(ValueError):
    pass


# What msgspec is told of each wire type; it refuses everything else, true where a number is expected included.
_TYPES: dict[str, Any] = {
    "uint": Annotated[int, msgspec.Meta(ge=0)],
    "bool": bool,
    "str": Annotated[str, msgspec.Meta(max_length=4096)],
    "bin": bytes,
    "real[*]": tuple[float, ...],
}
_RECORDS: dict[str, type] = {}


def _type_of(wire: str) -> Any:
    """The type that msgspec decodes a wire type into."""
    if wire in _TYPES:
        return _TYPES[wire]
    if match := re.fullmatch(r"real\[(\d+)\]", wire):
        return tuple.__class_getitem__((float,) * int(match[1]))
    if wire in _RECORDS:
        return tuple.__class_getitem__(tuple(_type_of(field.wire) for field in fields_of(_RECORDS[wire]).values()))
    return tuple[_type_of(wire.removesuffix("[*]")), ...]  # type: ignore[misc]


def _finite(values: Reals) -> None:
    # One addition chain is far cheaper than a test per element; only its failure looks closer.
    if not isfinite(sum(values)) and not all(map(isfinite, values)):
        index = next(i for i, x in enumerate(values) if not isfinite(x))
        raise _InvalidError(f"element {index} is {values[index]}, expected a finite number")


def _each_finite(rows: Sequence[Reals]) -> None:
    for values in rows:
        _finite(values)


def _builder(cls: type) -> Callable[[tuple[Any, ...]], Any]:
    """What makes a record or message out of its decoded fields, and refuses what is not finite."""
    checks: list[tuple[int, Callable[[Any], None]]] = []
    records: list[tuple[int, Callable[[tuple[Any, ...]], Any]]] = []
    for index, field in enumerate(fields_of(cls).values()):
        item = field.wire.removesuffix("[*]")
        if item in _RECORDS:
            records.append((index, _builder(_RECORDS[item])))
        elif item.startswith("real") and field.finite:
            checks.append((index, _each_finite if item.endswith("]") and item != field.wire else _finite))
    make = cls._make  # type: ignore[attr-defined]

    def build(values: tuple[Any, ...]) -> Any:
        for index, check in checks:
            check(values[index])
        if records:
            fields = list(values)
            for index, of in records:
                fields[index] = tuple([of(item) for item in values[index]])
            values = tuple(fields)
        return make(values)

    return build


_MESSAGES: dict[str, type] = {}
_DECODERS: dict[str, Callable[[bytes], Any]] = {}
_BY_HEAD: dict[bytes, str] = {}  # a kind as MessagePack writes it after the array's first byte
_KINDS: dict[type, str] = {}
_M = TypeVar("_M", bound=type)


@dataclass(frozen=True, slots=True)
class Route:
    """Where a message travels: key expression below the run's prefix, sender, receiver."""

    key: str
    sender: str
    receiver: str


_ROUTES: dict[str, Route] = {}


_ENCODER = msgspec.msgpack.Encoder()


def _decoder(cls: type) -> Callable[[bytes], Any]:
    types = tuple(_type_of(field.wire) for field in fields_of(cls).values())
    read = msgspec.msgpack.Decoder(tuple.__class_getitem__((str, *types))).decode
    build = _builder(cls)
    return lambda data: build(read(data)[1:])


def _record(cls: _M) -> _M:
    """Declare a record, so that fields may name it."""
    _RECORDS[cls.__name__] = cls
    return cls


def _declare(kind: str, key: str, sender: str, receiver: str) -> Callable[[_M], _M]:
    def register(cls: _M) -> _M:
        _MESSAGES[kind] = cls
        _KINDS[cls] = kind
        _DECODERS[kind] = _decoder(cls)
        _BY_HEAD[_ENCODER.encode(kind)] = kind
        _ROUTES[kind] = Route(key, sender, receiver)
        return cls

    return register


# ------------------------------------------------------------------------------------------ records


@_record
class Delivery(NamedTuple):
    """One payload that reaches an agent."""

    due_tick: Annotated[int, uint("tick", "first tick at which the receiver may use it")]
    sent_tick: Annotated[int, uint("tick", "round tick at which it was sent")]
    src: Annotated[int, uint("", "sending vehicle")]
    seq: Annotated[int, uint("", "number of the payload on its directed link, from 0")]
    copy: Annotated[int, uint("", "0 for the original, 1.. for duplicates made by the network")]
    payload: Annotated[bytes, Field("", "opaque to the network", "bin")]


@_record
class Fate(NamedTuple):
    """The one, final record of a packet: netem writes it at the tick where the fate became final."""

    final_tick: Annotated[int, uint("tick", "due tick if delivered, drop tick if lost, end tick if in flight")]
    src: Annotated[int, uint("", "sending vehicle")]
    dst: Annotated[int, uint("", "receiving vehicle")]
    seq: Annotated[int, uint("", "number of the payload on its directed link, from 0")]
    copy: Annotated[int, uint("", "0 for the original, 1.. for duplicates")]
    sent_tick: Annotated[int, uint("tick", "round tick at which it was sent")]
    due_tick: Annotated[int, uint("tick", "tick at which it was, or would have been, usable")]
    delay_ns: Annotated[int, uint("ns", "drawn delay of the link, before rounding up to ticks")]
    cause: Annotated[str, Field("", "delivered, in flight, or the cause of its loss", "str")]
    corrupted: Annotated[bool, Field("", "whether the link changed the payload", "bool")]
    payload: Annotated[bytes, Field("", "the payload's bytes", "bin")]


@_record
class VehicleFrame(NamedTuple):
    """One vehicle in one tick, as the world saw it."""

    id: Annotated[int, uint("", "vehicle number")]
    eta: Annotated[Reals, real("m, rad", "true x, y, z (NED), theta, psi", 5)]
    nu: Annotated[Reals, real("m/s, rad/s", "true u, v, w (body, over ground), q, r", 5)]
    nav: Annotated[Reals, real("", "what its sensor reported: eta then nu; empty when not sensed", None)]
    tau: Annotated[Reals, real("N, N m", "applied thrust and moments after limits; empty at the end", None)]
    command: Annotated[bytes, Field("", "the agent's Command message; empty when none", "bin")]


@_record
class Arrival(NamedTuple):
    """One delivery as its receiver saw it."""

    src: Annotated[int, uint("", "sending vehicle")]
    seq: Annotated[int, uint("", "number of the payload on its directed link")]
    copy: Annotated[int, uint("", "0 for the original, 1.. for duplicates")]
    at_ns: Annotated[int, uint("ns", "when it came in, by CLOCK_MONOTONIC of the agent's host")]


# ------------------------------------------------------------------------------------------ messages


@_declare("hello", "any", "any", "any")
class Hello(NamedTuple):
    """Readiness probe; whoever receives one on its own key answers with `echo` set."""

    role: Annotated[str, Field("", "agent, world, netem or console", "str")]
    id: Annotated[int, uint("", "vehicle number; 0 for other roles")]
    incarnation: Annotated[int, uint("", "0 for the first life of an agent, then 1, 2, ...")]
    version: Annotated[int, uint("", "protocol version")]
    echo: Annotated[bool, Field("", "true in the answer", "bool")]


@_declare("nav", "nav/{i}", "world", "agent i")
class Nav(NamedTuple):
    """The vehicle's own measured pose and velocity at a tick, and nothing else."""

    incarnation: Annotated[int, uint("", "life of the agent it is meant for")]
    tick: Annotated[int, uint("tick", "control tick; consecutive on this key")]
    eta: Annotated[Reals, real("m, rad", "x, y, z (NED), theta, psi (unwrapped)", 5)]
    nu: Annotated[Reals, real("m/s, rad/s", "u, v, w (body, over ground), q, r", 5)]


RUN_OVER = "the run is over"  # why nearly everyone's life ends


@_declare("end", "nav/{i}", "world", "agent i")
class End(NamedTuple):
    """No Nav follows for this life of the agent: it closes its session. Only agents that others started are told."""

    incarnation: Annotated[int, uint("", "life of the agent that is over; of a later one this says nothing")]
    tick: Annotated[int, uint("tick", "first tick without it; of no meaning when the run is over")]
    reason: Annotated[str, Field("", "one line for a person", "str")]


@_declare("cmd", "cmd/{i}", "agent i", "world")
class Command(NamedTuple):
    """The agent's answer to Nav of the same tick."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "tick of the Nav it answers")]
    tau: Annotated[Reals, real("N, N m", "surge force, pitch moment, yaw moment", 3)]
    telemetry: Annotated[
        Reals, real("", "controller signals in their declared order, or none at all", None, finite=False)
    ]


@_declare("memory", "cmd/{i}", "agent i", "world")
class Memory(NamedTuple):
    """All that an agent's next samples depend on; before the Command of a tick at which the run is kept whole."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "of the Command that follows")]
    state: Annotated[bytes, Field("", "its own affair, as MessagePack", "bin")]


@_declare("tx", "tx/{i}", "agent i", "netem")
class Transmission(NamedTuple):
    """What the agent sends at a round tick; an empty list is the null message and is required."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "round tick")]
    payloads: Annotated[tuple[bytes, ...], Field("", "each goes to every graph neighbour", "bin[*]")]


@_declare("receipt", "tx/{i}", "agent i", "netem")
class Receipt(NamedTuple):
    """With a real clock: the deliveries that an agent took at a tick, and when they had come. Optional."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "of the Nav at which it first used them")]
    arrivals: Annotated[tuple[Arrival, ...], Field("", "in the order in which they were used", "Arrival[*]")]


@_declare("rx", "rx/{i}", "netem", "agent i")
class Inbox(NamedTuple):
    """All that will be delivered to the agent after its previous inbox's `until`, up to this one's."""

    incarnation: Annotated[int, uint("", "life of the agent it is meant for")]
    until: Annotated[int, uint("tick", "the inbox is known up to this tick")]
    more: Annotated[bool, Field("", "more deliveries of the same inbox follow", "bool")]
    deliveries: Annotated[
        tuple[Delivery, ...],
        Field("", "ordered by (due, sent, src, seq, copy)", "Delivery[*]"),
    ]


@_declare("round", "round", "world", "netem")
class Round(NamedTuple):
    """Everyone's command for a round tick is in: who is alive, and where."""

    tick: Annotated[int, uint("tick", "round tick")]
    alive: Annotated[tuple[int, ...], Field("", "vehicles alive at the tick, ascending", "uint[*]")]
    positions: Annotated[
        tuple[Reals, ...],
        Field("m", "true x, y, z (NED) of each alive vehicle", "real[3][*]"),
    ]
    paused: Annotated[tuple[int, ...], Field("", "those of them that are suspended: no transmission comes", "uint[*]")]


@_declare("pace", "round", "world", "netem")
class Pace(NamedTuple):
    """With a real clock: when ticks begin, before the Round of the same tick."""

    tick: Annotated[int, uint("tick", "round tick")]
    at_ns: Annotated[int, uint("ns", "when it begins, by CLOCK_MONOTONIC of the world's host")]
    period_ns: Annotated[int, uint("ns", "of wall time per tick, until told otherwise")]


@_record
class Life(NamedTuple):
    """A vehicle lost its agent, or got another one."""

    tick: Annotated[int, uint("tick", "first tick without, or with")]
    vehicle: Annotated[int, uint("", "vehicle number")]
    begins: Annotated[bool, Field("", "true when another agent takes over", "bool")]
    diverged: Annotated[
        bool, Field("", "true when the vehicle's motion left the finite numbers: it is not integrated any more", "bool")
    ]


@_record
class Tumble(NamedTuple):
    """A vehicle's pitch went beyond its limit, or came back."""

    tick: Annotated[int, uint("tick", "first tick at which it is so")]
    vehicle: Annotated[int, uint("", "vehicle number")]
    begins: Annotated[bool, Field("", "false when the vehicle has come back", "bool")]
    number: Annotated[int, uint("", "how often it has tumbled, this time included")]


@_record
class Frame(NamedTuple):
    """All vehicles at one tick; the log's source."""

    tick: Annotated[int, uint("tick", "control tick; consecutive on this key")]
    more: Annotated[bool, Field("", "more vehicles of the same tick follow", "bool")]
    lives: Annotated[tuple[Life, ...], Field("", "since the frame before; with the first part", "Life[*]")]
    tumbles: Annotated[tuple[Tumble, ...], Field("", "likewise", "Tumble[*]")]
    vehicles: Annotated[
        tuple[VehicleFrame, ...],
        Field("", "ascending by id", "VehicleFrame[*]"),
    ]
    memory: Annotated[
        bytes, Field("", "of the world and all agents before this tick, as MessagePack; mostly empty", "bin")
    ]


@_declare("frames", "frame", "world", "console")
class Frames(NamedTuple):
    """Consecutive frames in one message: the world saves a message per tick while it has more to do."""

    frames: Annotated[tuple[Frame, ...], Field("", "ascending by tick", "Frame[*]")]


@_declare("links", "links", "netem", "console")
class LinkReport(NamedTuple):
    """Every fate that became final after the previous report's `until`, up to this one's."""

    until: Annotated[int, uint("tick", "fates are complete up to this tick")]
    closing: Annotated[bool, Field("", "true for the last report of a run", "bool")]
    more: Annotated[bool, Field("", "more fates of the same report follow", "bool")]
    fates: Annotated[
        tuple[Fate, ...],
        Field("", "ordered by (final, src, dst, seq, copy)", "Fate[*]"),
    ]
    memory: Annotated[bytes, Field("", "of the network before this round, as MessagePack; mostly empty", "bin")]


@_declare("grant", "cmd/grant", "console", "world")
class Grant(NamedTuple):
    """Ticks below `until` may be started."""

    until: Annotated[int, uint("tick", "state `until` will exist, Nav(`until`) is not sent")]


@_declare("death", "cmd/grant", "console", "world")
class Death(NamedTuple):
    """An agent has ended, or will: from a tick on its vehicle is not waited for any more."""

    vehicle: Annotated[int, uint("", "vehicle number")]
    tick: Annotated[int, uint("tick", "first tick without an agent; 0: its process has ended, it is the next one")]
    incarnation: Annotated[int, uint("", "the life that ended, if it has")]
    until: Annotated[int, uint("tick", "round tick at which another agent takes over; 0: none that was not planned")]


@_declare("restart", "cmd/grant", "console", "world")
class Restart(NamedTuple):
    """Another agent takes a vehicle over earlier than was said; that tick is not granted before it is ready."""

    vehicle: Annotated[int, uint("", "vehicle number")]
    begin: Annotated[int, uint("tick", "since when it has none; 2^63 - 1: whenever")]
    tick: Annotated[int, uint("tick", "round tick, its first sample")]


@_declare("ailments", "cmd/grant", "console", "world")
class Ailments(NamedTuple):
    """The faults of sensors, actuators and sea, all of them: they replace those that were told before."""

    faults: Annotated[bytes, Field("", "MessagePack: a list of world.faults.WorldFault values", "bin")]


@_declare("note", "note", "world, netem, agents", "console")
class Note(NamedTuple):
    """Something a person should know: a rejected message, a failed controller, a counter."""

    role: Annotated[str, Field("", "who noticed", "str")]
    subject: Annotated[int, uint("", "vehicle concerned; 0 for none")]
    tick: Annotated[int, uint("tick", "tick at which it was noticed")]
    text: Annotated[str, Field("", "one line", "str")]


Told = Grant | Death | Restart | Ailments  # by the console to the world
Timed = Pace | Receipt  # only with a real clock
Message = (
    Hello | Nav | End | Command | Memory | Transmission | Inbox | Round | Frames | LinkReport | Told | Timed | Note
)


def encode(message: Message) -> bytes:
    """MessagePack array `[kind, field, ...]` of a declared message."""
    return _ENCODER.encode((_KINDS[type(message)], *message))


def decode(data: bytes) -> Message:
    """The message in `data`, every field checked against its declaration.

    Raises:
        MalformedMessage: not MessagePack, not an array, an unknown kind, or a field out of range.
    """
    # The kind as every encoder of short arrays writes it; what is written otherwise takes the long way.
    kind = _BY_HEAD.get(data[1 : 2 + (data[1] & 0x1F)]) if len(data) > 1 else None
    if kind is None:
        kind = _kind_of(data)
    try:
        message: Message = _DECODERS[kind](data)
    except _InvalidError as error:
        raise MalformedMessage(kind, str(error)) from None
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise MalformedMessage(kind, _explain(kind, str(error) or type(error).__name__)) from None
    return message


def _kind_of(data: bytes) -> str:
    try:
        values = msgspec.msgpack.decode(data)
    except Exception as error:  # bytes that are no MessagePack, in one of many ways
        raise MalformedMessage("unknown", f"not MessagePack ({error or type(error).__name__})"[:150]) from None
    if type(values) is not list or not values or type(values[0]) is not str:
        raise MalformedMessage("unknown", "expected an array that starts with the message kind")
    if values[0] not in _DECODERS:
        raise MalformedMessage("unknown", f"no message kind {values[0]!r:.40}")
    return values[0]


def _explain(kind: str, reason: str) -> str:
    """msgspec's words with the field's name: ``Expected `int` >= 0 - at `$[1]` `` of a nav is about its incarnation."""
    reason = reason.replace("Expected `int` >= 0", "expected an unsigned integer")
    match = re.search(r"(.*) - at `\$\[(\d+)\](.*)`", reason)
    if match is None:
        return reason
    names = ["kind", *fields_of(_MESSAGES[kind])]
    index = int(match[2])
    return f"{names[index] if index < len(names) else index}{match[3]}: {match[1]}"


_T = TypeVar("_T")


def split(items: Sequence[_T], size: Callable[[_T], int], limit: int) -> Iterator[tuple[Sequence[_T], bool]]:
    """Consecutive parts of `items`, each of at most `limit` bytes or a single item, with whether more follow."""
    begin = total = 0
    for index, item in enumerate(items):
        total += (one := size(item))
        if total > limit and index > begin:
            yield items[begin:index], True
            begin, total = index, one
    yield items[begin:], False


def pieces(data: bytes, limit: int) -> list[bytes]:
    """The same bytes, at most `limit` at a time; none of no bytes."""
    return [data[begin : begin + limit] for begin in range(0, len(data), limit)]


def declared() -> dict[str, tuple[type, Route]]:
    """Every message kind with its class and its route, for the protocol page and the tests' sweep."""
    return {kind: (cls, _ROUTES[kind]) for kind, cls in _MESSAGES.items()}
