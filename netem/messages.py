"""Every message of a run, declared once: field, unit, one-line meaning.

A message is a MessagePack array `[kind, field, field, ...]` in the declared order. The encoder, the strict
decoder and the protocol page (`fleet protocol`) all follow from the declarations in this file.

Integers are unsigned; reals are IEEE-754 doubles (an integer is accepted where a real is expected, because
some languages' MessagePack writes 1.0 as 1). Ticks count control periods Ts from the start of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

import msgpack

from netem.errors import MalformedMessage

PROTOCOL_VERSION = 1

Check = Callable[[Any], Any]
Reals = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Field:
    """The declaration of one field: unit ("" when it has none), meaning, wire type and its check."""

    unit: str
    meaning: str
    wire: str
    check: Check


class _Invalid(ValueError):
    pass


def _uint(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise _Invalid(f"expected an unsigned integer, got {value!r:.60}")
    return value


def _flag(value: Any) -> bool:
    if type(value) is not bool:
        raise _Invalid(f"expected true or false, got {value!r:.60}")
    return value


def _text(value: Any) -> str:
    if type(value) is not str or len(value) > 4096:
        raise _Invalid(f"expected a short text, got {value!r:.60}")
    return value


def _binary(value: Any) -> bytes:
    if type(value) is not bytes:
        raise _Invalid(f"expected bytes, got {value!r:.60}")
    return value


def _reals(size: int | None = None, finite: bool = True) -> Check:
    def check(value: Any) -> Reals:
        if type(value) is not list or (size is not None and len(value) != size):
            raise _Invalid(f"expected {'an array of' if size is None else size} reals, got {value!r:.60}")
        kinds = set(map(type, value))
        if not kinds <= {float, int}:
            raise _Invalid(f"expected reals only, got {value!r:.60}")
        if kinds != {float}:
            value = list(map(float, value))
        # One addition chain is far cheaper than a test per element; only its failure looks closer.
        if finite and not isfinite(sum(value)) and not all(map(isfinite, value)):
            index = next(i for i, x in enumerate(value) if not isfinite(x))
            raise _Invalid(f"element {index} is {value[index]}, expected a finite number")
        return tuple(value)

    return check


def _array(item: Check) -> Check:
    def check(value: Any) -> tuple[Any, ...]:
        if type(value) is not list:
            raise _Invalid(f"expected an array, got {value!r:.60}")
        return tuple(item(element) for element in value)

    return check


def _record(cls: type) -> Check:
    fields = tuple(fields_of(cls).values())
    checks = tuple(field.check for field in fields)
    count = len(checks)
    make = cls._make  # type: ignore[attr-defined]

    def check(value: Any) -> Any:
        if type(value) is not list or len(value) != count:
            raise _Invalid(f"expected an array of {count} fields for {cls.__name__}, got {value!r:.60}")
        return make([test(element) for test, element in zip(checks, value, strict=True)])

    return check


def fields_of(cls: type) -> dict[str, Field]:
    """The declared fields of a message or record, in wire order."""
    found = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        found[name] = next(a for a in get_args(hint) if isinstance(a, Field))
    return found


def uint(unit: str, meaning: str) -> Field:
    return Field(unit, meaning, "uint", _uint)


def real(unit: str, meaning: str, size: int | None, *, finite: bool = True) -> Field:
    wire = f"real[{'*' if size is None else size}]"
    return Field(unit, meaning, wire, _reals(size, finite))


_MESSAGES: dict[str, type] = {}
_DECODERS: dict[str, Check] = {}
_KINDS: dict[type, str] = {}
_M = TypeVar("_M", bound=type)


@dataclass(frozen=True, slots=True)
class Route:
    """Where a message travels: key expression below the run's prefix, sender, receiver."""

    key: str
    sender: str
    receiver: str


_ROUTES: dict[str, Route] = {}


def _declare(kind: str, key: str, sender: str, receiver: str) -> Callable[[_M], _M]:
    def register(cls: _M) -> _M:
        _MESSAGES[kind] = cls
        _KINDS[cls] = kind
        _DECODERS[kind] = _record(cls)
        _ROUTES[kind] = Route(key, sender, receiver)
        return cls

    return register


# ------------------------------------------------------------------------------------------ records


class Delivery(NamedTuple):
    """One payload that reaches an agent."""

    due_tick: Annotated[int, uint("tick", "first tick at which the receiver may use it")]
    sent_tick: Annotated[int, uint("tick", "round tick at which it was sent")]
    src: Annotated[int, uint("", "sending vehicle")]
    seq: Annotated[int, uint("", "number of the payload on its directed link, from 0")]
    copy: Annotated[int, uint("", "0 for the original, 1.. for duplicates made by the network")]
    payload: Annotated[bytes, Field("", "opaque to the network", "bin", _binary)]


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
    cause: Annotated[str, Field("", "delivered, in flight, or the cause of its loss", "str", _text)]
    payload: Annotated[bytes, Field("", "the payload's bytes", "bin", _binary)]


class VehicleFrame(NamedTuple):
    """One vehicle in one tick, as the world saw it."""

    id: Annotated[int, uint("", "vehicle number")]
    eta: Annotated[Reals, real("m, rad", "true x, y, z (NED), theta, psi", 5)]
    nu: Annotated[Reals, real("m/s, rad/s", "true u, v, w (body, over ground), q, r", 5)]
    nav: Annotated[Reals, real("", "what its sensor reported: eta then nu; empty when not sensed", None)]
    tau: Annotated[Reals, real("N, N m", "applied thrust and moments after limits; empty at the end", None)]
    command: Annotated[bytes, Field("", "the agent's Command message; empty when none", "bin", _binary)]


# ------------------------------------------------------------------------------------------ messages


@_declare("hello", "any", "any", "any")
class Hello(NamedTuple):
    """Readiness probe; whoever receives one on its own key answers with `echo` set."""

    role: Annotated[str, Field("", "agent, world, netem or console", "str", _text)]
    id: Annotated[int, uint("", "vehicle number; 0 for other roles")]
    incarnation: Annotated[int, uint("", "0 for the first life of an agent, then 1, 2, ...")]
    version: Annotated[int, uint("", "protocol version")]
    echo: Annotated[bool, Field("", "true in the answer", "bool", _flag)]


@_declare("nav", "nav/{i}", "world", "agent i")
class Nav(NamedTuple):
    """The vehicle's own measured pose and velocity at a tick, and nothing else."""

    incarnation: Annotated[int, uint("", "life of the agent it is meant for")]
    tick: Annotated[int, uint("tick", "control tick; consecutive on this key")]
    eta: Annotated[Reals, real("m, rad", "x, y, z (NED), theta, psi (unwrapped)", 5)]
    nu: Annotated[Reals, real("m/s, rad/s", "u, v, w (body, over ground), q, r", 5)]


@_declare("cmd", "cmd/{i}", "agent i", "world")
class Command(NamedTuple):
    """The agent's answer to Nav of the same tick."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "tick of the Nav it answers")]
    tau: Annotated[Reals, real("N, N m", "surge force, pitch moment, yaw moment", 3)]
    telemetry: Annotated[Reals, real("", "controller signals in their declared order", None, finite=False)]


@_declare("tx", "tx/{i}", "agent i", "netem")
class Transmission(NamedTuple):
    """What the agent sends at a round tick; an empty list is the null message and is required."""

    incarnation: Annotated[int, uint("", "life of the sending agent")]
    tick: Annotated[int, uint("tick", "round tick")]
    payloads: Annotated[tuple[bytes, ...], Field("", "each goes to every graph neighbour", "bin[*]", _array(_binary))]


@_declare("rx", "rx/{i}", "netem", "agent i")
class Inbox(NamedTuple):
    """All that will be delivered to the agent after its previous inbox's `until`, up to this one's."""

    incarnation: Annotated[int, uint("", "life of the agent it is meant for")]
    until: Annotated[int, uint("tick", "the inbox is known up to this tick")]
    more: Annotated[bool, Field("", "more deliveries of the same inbox follow", "bool", _flag)]
    deliveries: Annotated[
        tuple[Delivery, ...],
        Field("", "ordered by (due, sent, src, seq, copy)", "Delivery[*]", _array(_record(Delivery))),
    ]


@_declare("round", "round", "world", "netem")
class Round(NamedTuple):
    """Everyone's command for a round tick is in: who is alive, and where."""

    tick: Annotated[int, uint("tick", "round tick")]
    alive: Annotated[tuple[int, ...], Field("", "vehicles alive at the tick, ascending", "uint[*]", _array(_uint))]
    positions: Annotated[
        tuple[Reals, ...],
        Field("m", "true x, y, z (NED) of each alive vehicle", "real[3][*]", _array(_reals(3))),
    ]


class Frame(NamedTuple):
    """All vehicles at one tick; the log's source."""

    tick: Annotated[int, uint("tick", "control tick; consecutive on this key")]
    more: Annotated[bool, Field("", "more vehicles of the same tick follow", "bool", _flag)]
    vehicles: Annotated[
        tuple[VehicleFrame, ...],
        Field("", "ascending by id", "VehicleFrame[*]", _array(_record(VehicleFrame))),
    ]


@_declare("frames", "frame", "world", "console")
class Frames(NamedTuple):
    """Consecutive frames in one message: the world saves a message per tick while it has more to do."""

    frames: Annotated[tuple[Frame, ...], Field("", "ascending by tick", "Frame[*]", _array(_record(Frame)))]


@_declare("links", "links", "netem", "console")
class LinkReport(NamedTuple):
    """Every fate that became final after the previous report's `until`, up to this one's."""

    until: Annotated[int, uint("tick", "fates are complete up to this tick")]
    closing: Annotated[bool, Field("", "true for the last report of a run", "bool", _flag)]
    more: Annotated[bool, Field("", "more fates of the same report follow", "bool", _flag)]
    fates: Annotated[
        tuple[Fate, ...],
        Field("", "ordered by (final, src, dst, seq, copy)", "Fate[*]", _array(_record(Fate))),
    ]


@_declare("grant", "cmd/grant", "console", "world")
class Grant(NamedTuple):
    """Ticks below `until` may be started."""

    until: Annotated[int, uint("tick", "state `until` will exist, Nav(`until`) is not sent")]


@_declare("note", "note", "world, netem, agents", "console")
class Note(NamedTuple):
    """Something a person should know: a rejected message, a failed controller, a counter."""

    role: Annotated[str, Field("", "who noticed", "str", _text)]
    subject: Annotated[int, uint("", "vehicle concerned; 0 for none")]
    tick: Annotated[int, uint("tick", "tick at which it was noticed")]
    text: Annotated[str, Field("", "one line", "str", _text)]


Message = Hello | Nav | Command | Transmission | Inbox | Round | Frames | LinkReport | Grant | Note


def encode(message: Message) -> bytes:
    """MessagePack array `[kind, field, ...]` of a declared message."""
    data: bytes = msgpack.packb((_KINDS[type(message)], *message))
    return data


def decode(data: bytes) -> Message:
    """The message in `data`, every field checked against its declaration.

    Raises:
        MalformedMessage: not MessagePack, not an array, an unknown kind, or a field out of range.
    """
    try:
        values = msgpack.unpackb(data)
    except Exception as error:  # msgpack raises half a dozen unrelated types for bad bytes
        raise MalformedMessage("unknown", f"not MessagePack ({error or type(error).__name__})") from None
    if type(values) is not list or not values or type(values[0]) is not str:
        raise MalformedMessage("unknown", "expected an array that starts with the message kind")
    kind = values[0]
    decoder = _DECODERS.get(kind)
    if decoder is None:
        raise MalformedMessage("unknown", f"no message kind {kind!r:.40}")
    try:
        message: Message = decoder(values[1:])
    except _Invalid as error:
        raise MalformedMessage(kind, str(error)) from None
    except OverflowError:
        raise MalformedMessage(kind, "a number is too large for a double") from None
    return message


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


def declared() -> dict[str, tuple[type, Route]]:
    """Every message kind with its class and its route, for the protocol page and the tests' sweep."""
    return {kind: (cls, _ROUTES[kind]) for kind, cls in _MESSAGES.items()}
