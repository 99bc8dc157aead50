"""Messages to bytes and back; what is not declared in `netem.wire.messages` is refused with a reason."""

from __future__ import annotations

import re
from operator import attrgetter
from typing import get_args

import msgspec

from netem.errors import MalformedMessage
from netem.wire.messages import Command, Delivery, Fate, Inbox, LinkReport, Message, Nav, Round

LONGEST_REASON = 150  # characters, so that a sender cannot fill the logs
_CLASSES: dict[str, type[msgspec.Struct]] = {cls.__struct_config__.tag: cls for cls in get_args(Message)}
_NOT_FINITE = re.compile(r"Expected `float` [<>]= -?1\.79\S+(?= - at `\$(.*)`)")  # every field has a place
_ENCODER = msgspec.msgpack.Encoder()
# The heads of arrays of five, six and seven: a nav without roll, clock and belief, and so on.
_NAV, _NAV_WITH_ROLL, _NAV_WITH_CLOCK = b"\x95", b"\x96", b"\x97"
_SILENT_COMMAND = b"\x95"  # a command with which nothing is said, as agents know it that were written before
_LAST_ROUND = b"\x95"  # a round that fits into one message, as nearly all, is written as before there were parts
_DELIVERY = attrgetter(*Delivery.__struct_fields__[:6])
_FATE = attrgetter(*Fate.__struct_fields__[:11])
_DECODER: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    """MessagePack array `[kind, field, ...]` of a declared message."""
    if type(message) is Inbox and message.deliveries:
        # What was written before there were ranges knows deliveries and fates without.
        deliveries = [d if _has_range(d) else _DELIVERY(d) for d in message.deliveries]
        return _ENCODER.encode(("rx", message.incarnation, message.until, message.more, deliveries))
    if type(message) is LinkReport and message.fates:
        fates = [_FATE(fate) if fate.measured is None else fate for fate in message.fates]
        return _ENCODER.encode(("links", message.until, message.closing, message.more, fates))
    data = _ENCODER.encode(message)
    if type(message) is Command and not message.said:
        return _SILENT_COMMAND + data[1:-1]
    if type(message) is Nav and not message.belief:
        # Agents that were written before there was roll, a clock, or belief know it without.
        if message.clock_ns is not None:
            return _NAV_WITH_CLOCK + data[1:-1]
        return _NAV_WITH_ROLL + data[1:-2] if message.roll else _NAV + data[1:-3]
    if type(message) is Round and not message.more:
        return _LAST_ROUND + data[1:-1]
    return data


def _has_range(d: Delivery) -> bool:
    return d.range_m is not None or d.range_sd_m is not None or d.range_tick is not None


def decode(data: bytes) -> Message:
    """The message in `data`, every field checked against its declaration. Raises MalformedMessage if it is not
    MessagePack, not an array, of an unknown kind, or has a field out of range.
    """
    try:
        return _DECODER.decode(data)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        kind = _kind_of(data)
        raise MalformedMessage(
            kind, _explain(kind, data, str(error) or type(error).__name__)[:LONGEST_REASON]
        ) from None


def expect(data: bytes, *kinds: type) -> Message:
    """Decode a message that must be of one of the given kinds. Raises MalformedMessage: it is not."""
    message = decode(data)
    if not isinstance(message, kinds):
        raise MalformedMessage(
            type(message).__name__.lower(), f"expected {' or '.join(k.__name__ for k in kinds)} on this key"
        )
    return message


def _kind_of(data: bytes) -> str:
    try:
        values = msgspec.msgpack.decode(data)
    except Exception as error:  # bytes that are no MessagePack, in one of many ways
        raise MalformedMessage(
            "unknown", f"not MessagePack ({error or type(error).__name__})"[:LONGEST_REASON]
        ) from None
    if type(values) is not list or not values or type(values[0]) is not str:
        raise MalformedMessage("unknown", "expected an array that starts with the message kind")
    if values[0] not in _CLASSES:
        raise MalformedMessage("unknown", f"no message kind {values[0]!r:.40}")
    return values[0]


def _explain(kind: str, data: bytes, reason: str) -> str:
    """The words of msgspec with the field's name: ``Expected `int` >= 0 - at `$[1]` `` of a nav is its incarnation."""
    reason = reason.replace("Expected `int` >= 0", "expected an unsigned integer")
    reason = _NOT_FINITE.sub(lambda bound: f"expected a finite number{_value_at(data, bound[1])}", reason)
    match = re.search(r"(.*) - at `\$\[(\d+)\](.*)`", reason)
    if match is None:
        return reason
    names = ["kind", *_CLASSES[kind].__struct_fields__]
    index = int(match[2])
    return f"{names[index] if index < len(names) else index}{match[3]}: {match[1]}"


def _value_at(data: bytes, path: str) -> str:
    """`, got VALUE` for the value at a path such as `[3][0]`; "" where the path leaves an index open."""
    value = msgspec.msgpack.decode(data)
    for index in re.findall(r"\[([^\]]*)\]", path):
        if not index.isdecimal():
            return ""
        value = value[int(index)]
    return f", got {value!r:.40}"
