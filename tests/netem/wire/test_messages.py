"""The codec, message by message: what is declared goes over the wire unchanged, and nothing else gets in.

Every test sweeps `declared()`, with values generated from the declarations: a message that is added later is tested
without a word here.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isnan, nan
from typing import Any

import msgpack
import pytest
from any_message import ANY_MESSAGE, ARRAY, KINDS, OR_NIL, RECORDS, messages
from hypothesis import example, given
from hypothesis import strategies as st

from fleet.addons.hosts.protocol.page import fields_of, message_kinds, records, texts
from netem.errors import MalformedMessage
from netem.wire.codec import decode, encode, expect
from netem.wire.control import read_map
from netem.wire.messages import Command, Grant, Hello, Message, Nav, Said


def plainest(wire: str) -> Any:
    """The smallest value of a wire type, as it stands on the wire; an array without a size has one element."""
    if wire in RECORDS:
        return [plainest(field.wire) for field in fields_of(RECORDS[wire]).values()]
    if wire in texts():
        return min(texts()[wire]).value
    if wire.endswith(OR_NIL):
        return None
    if match := ARRAY.fullmatch(wire):
        item, size = match.groups()
        return [plainest(item)] * (1 if size == "*" else int(size.removeprefix("..")))
    return {"uint": 0, "real": 0.5, "bool": False, "str": "", "bin": b""}[wire]


def spoilt(wire: str) -> Iterator[Any]:
    """Values that a wire type does not allow: wrong types, signs, sizes, numbers that are none; and one of those at
    each place inside."""
    good = plainest(wire)
    if wire in RECORDS:
        for index, field in enumerate(fields_of(RECORDS[wire]).values()):
            yield from ([*good[:index], bad, *good[index + 1 :]] for bad in spoilt(field.wire))
        may_lack = len(RECORDS[wire].__struct_defaults__)
        yield from (good[: -1 - may_lack], [*good, 0], [], None, 0, {}, "")
    elif wire.endswith(OR_NIL):
        yield from (bad for bad in spoilt(wire.removesuffix(OR_NIL)) if bad is not None)
    elif match := ARRAY.fullmatch(wire):
        item, size = match.groups()
        for index in range(len(good)):
            yield from ([*good[:index], bad, *good[index + 1 :]] for bad in spoilt(item))
        if size != "*":
            yield [*good, good[0]]
        if size.isdigit():
            yield from (good[:-1], [])
        yield from (None, 0, 0.5, {}, "", b"", dict.fromkeys("012", good[0]))
    elif wire in texts():
        yield from (None, True, 0, 0.5, b"", [], {}, "", "x" * 4097, good.upper(), f"{good} ")
    else:
        everything = [None, True, 0, -1, -(2**63), 0.5, nan, inf, -inf, "0", "x" * 4097, b"", [], [0], {}]
        everything += [msgpack.ExtType(1, b""), msgpack.Timestamp(1)]
        allowed = {
            "uint": lambda v: type(v) is int and v >= 0,
            "real": lambda v: type(v) in (int, float) and not isnan(v) and abs(v) != inf,
            "bool": lambda v: type(v) is bool,
            "str": lambda v: type(v) is str and len(v) <= 4096,
            "bin": lambda v: type(v) is bytes,
        }[wire]
        yield from (value for value in everything if not allowed(value))


# --- round trips -----------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_round_trip(kind: str, data: st.DataObject) -> None:
    """decode is the left inverse of encode, to the last bit and the type; and there is one encoding of a message."""
    message = data.draw(messages(message_kinds()[kind][0]))
    wire = encode(message)
    found = decode(wire)
    assert found == message
    assert type(found) is type(message)
    assert encode(found) == wire
    assert msgpack.unpackb(wire)[0] == kind


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_declared_with_its_meaning(kind: str) -> None:
    """The protocol page is made of these; a field without a declaration would be read unchecked."""
    cls, route = message_kinds()[kind]
    assert list(fields_of(cls)) == list(cls.__struct_fields__)
    assert all(field.meaning for field in fields_of(cls).values())
    assert route.key
    assert cls.__doc__


def test_integers_are_read_as_reals() -> None:
    """Some languages' MessagePack writes 1.0 as 1; a message of theirs is the same message."""
    wire = msgpack.packb(["nav", 0, 3, [1, 2, 3, 4, 5], [0.5, 0, 0, 0, 0]])
    found = decode(wire)
    assert found == Nav(0, 3, (1.0, 2.0, 3.0, 4.0, 5.0), (0.5, 0.0, 0.0, 0.0, 0.0))
    assert isinstance(found, Nav)
    assert {type(x) for x in found.eta + found.nu} == {float}


def test_a_nav_without_roll_and_clock_is_the_one_that_it_always_was() -> None:
    """Agents that were written when no vehicle could roll, and all clocks were right, go on."""
    old = msgpack.packb(["nav", 0, 3, [1.0, 2.0, 3.0, 4.0, 5.0], [0.5, 0.0, 0.0, 0.0, 0.0]])
    nav = Nav(0, 3, (1.0, 2.0, 3.0, 4.0, 5.0), (0.5, 0.0, 0.0, 0.0, 0.0))
    assert encode(nav) == old
    assert decode(old) == nav
    rolled = Nav(0, 3, nav.eta, nav.nu, (0.1, -0.2))
    assert msgpack.unpackb(encode(rolled)) == [*msgpack.unpackb(old), [0.1, -0.2]]
    assert decode(encode(rolled)) == rolled
    for roll in ((), (0.1, -0.2)):
        told = Nav(0, 3, nav.eta, nav.nu, roll, 30_000_001)
        assert msgpack.unpackb(encode(told)) == [*msgpack.unpackb(old), [*roll], 30_000_001]
        assert decode(encode(told)) == told
        sure = Nav(0, 3, nav.eta, nav.nu, roll, None, tuple(map(float, range(10))))
        assert msgpack.unpackb(encode(sure))[5:] == [[*roll], None, [*sure.belief]]
        assert decode(encode(sure)) == sure


def test_a_command_with_which_nothing_is_said_is_the_one_that_it_always_was() -> None:
    """Agents that were written before commands could carry lines go on, and so does a world of that time."""
    old = msgpack.packb(["cmd", 0, 3, [1.0, 2.0, 3.0], [4.0]])
    command = Command(0, 3, (1.0, 2.0, 3.0), (4.0,))
    assert encode(command) == old
    assert decode(old) == command
    talking = Command(0, 3, (1.0, 2.0, 3.0), (4.0,), (Said(30, "out", "hello"),))
    assert msgpack.unpackb(encode(talking)) == [*msgpack.unpackb(old), [[30, "out", "hello"]]]


def test_telemetry_may_hold_anything() -> None:
    """Telemetry is for people and decides nothing: a NaN in it is shown, not refused."""
    found = decode(encode(Command(0, 1, (0.0, 0.0, 0.0), (nan, inf, -inf))))
    assert isinstance(found, Command)
    assert isnan(found.telemetry[0])
    assert found.telemetry[1:] == (inf, -inf)


@pytest.mark.parametrize("value", [-0.0, 5e-324, 1.7976931348623157e308, 0.1 + 0.2])
def test_reals_keep_their_bits(value: float) -> None:
    found = decode(encode(Command(0, 0, (value, -value, 0.0), (value,))))
    assert isinstance(found, Command)
    assert [x.hex() for x in found.tau] == [value.hex(), (-value).hex(), (0.0).hex()]


def test_every_record_is_named_by_a_field() -> None:
    """A record that no message can carry would be a heading of the protocol page about nothing."""
    named = {field.wire for cls, _ in message_kinds().values() for field in fields_of(cls).values()}
    named |= {field.wire for cls in records().values() for field in fields_of(cls).values()}
    assert all(f"{name}[*]" in named or f"{name}{OR_NIL}" in named for name in records())


# --- what is refused -------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_refuses_what_it_is_not(kind: str) -> None:
    """Each field of each message, nested records included: NaN, infinities, negative or huge numbers, wrong types and
    wrong lengths. The same message with plain values passes, so it is the spoilt value that is refused."""
    fields = list(fields_of(message_kinds()[kind][0]).items())
    good = [plainest(field.wire) for _, field in fields]
    decode(msgpack.packb([kind, *good]))
    for index, (name, field) in enumerate(fields):
        for bad in spoilt(field.wire):
            if name == "telemetry" and isinstance(bad, list) and all(type(x) is float for x in bad):
                continue  # the one field that need not be finite
            wire = msgpack.packb([kind, *good[:index], bad, *good[index + 1 :]])
            with pytest.raises(MalformedMessage) as caught:
                decode(wire)
            assert caught.value.kind == kind, (name, bad)


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_number_of_fields(kind: str) -> None:
    cls = message_kinds()[kind][0]
    good = [plainest(field.wire) for field in fields_of(cls).values()]
    may_lack = len(cls.__struct_defaults__)
    if may_lack:
        decode(msgpack.packb([kind, *good[:-may_lack]]))
    for fields in ([], good[: -1 - may_lack], good[1:], [*good, 0], [*good, None]):
        with pytest.raises(MalformedMessage):
            decode(msgpack.packb([kind, *fields]))


def test_negative_and_huge_integers() -> None:
    """The wire's own range is -2^63 .. 2^64 - 1; of it, unsigned integers take the upper part."""
    for tick in (0, 2**63, 2**64 - 1):
        assert decode(msgpack.packb(["grant", tick])) == Grant(tick)
    for tick in (-1, -(2**63)):
        with pytest.raises(MalformedMessage, match="unsigned"):
            decode(msgpack.packb(["grant", tick]))


@pytest.mark.parametrize(
    "wire",
    [
        b"",
        b"\xc1",  # the one byte that MessagePack never uses
        b"\x90",  # an empty array
        b"\xc0",
        b"\x81\xa1k\x00",
        msgpack.packb(["Nav", 0]),
        msgpack.packb([b"nav", 0]),
        msgpack.packb(["nope", 0]),
        msgpack.packb(["x" * 10_000]),
        msgpack.packb("nav"),
        b"\xdd\xff\xff\xff\xff",  # an array that claims 2^32 - 1 elements
        b"\xc6\xff\xff\xff\xff",  # and as many bytes
        b"\xdf\xff\xff\xff\xff",
        b"\x91" * 100_000,  # arrays in arrays
        b"\x92\xa5grant\xa2\xff\xfe",  # a text that is not UTF-8
        encode(Hello("world", 0, 0, 1, True)) + b"\x00",  # a message and a byte
        encode(Hello("world", 0, 0, 1, True)) * 2,
        encode(Hello("world", 0, 0, 1, True))[:-1],
    ],
    ids=lambda wire: repr(wire[:12]),
)
def test_what_is_no_message(wire: bytes) -> None:
    with pytest.raises(MalformedMessage):
        decode(wire)


def test_the_reason_is_short() -> None:
    """What an attacker sends is not what fills the logs."""
    with pytest.raises(MalformedMessage) as caught:
        decode(msgpack.packb(["note", "x" * 30_000, 0, 0, ""]))
    assert len(str(caught.value)) < 200


# --- fuzz ------------------------------------------------------------------

PLAIN = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**63), 2**64 - 1),
        st.floats(),
        st.text(max_size=8),
        st.sampled_from(KINDS),
        st.binary(max_size=8),
        st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=4)),
    ),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=20,
)


def taken_or_refused(wire: bytes) -> None:
    """A message that encodes again to itself, or MalformedMessage, and nothing else."""
    try:
        message = decode(wire)
    except MalformedMessage:
        return
    assert repr(decode(encode(message))) == repr(message)  # repr, because a NaN of telemetry equals nothing


@given(st.binary(max_size=300))
@example(b"\xc7\x0c\xff" + b"\xff" * 12)  # a timestamp out of range
def test_arbitrary_bytes(wire: bytes) -> None:
    taken_or_refused(wire)


@given(st.lists(PLAIN, max_size=8), st.sampled_from(KINDS))
def test_arbitrary_values_under_a_known_kind(fields: list[Any], kind: str) -> None:
    """Well-formed MessagePack, so that the fields' own checks are reached."""
    taken_or_refused(msgpack.packb([kind, *fields]))


@given(ANY_MESSAGE, st.data())
def test_mutated_bytes(message: Message, data: st.DataObject) -> None:
    """Flips, cuts and insertions in valid messages, which get further than noise does."""
    wire = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(wire) - 1)))
        match data.draw(st.sampled_from(["flip", "cut", "drop", "insert", "replace"])):
            case "flip" if wire:
                wire[at] ^= 1 << data.draw(st.integers(0, 7))
            case "cut":
                del wire[at:]
            case "drop":
                del wire[at : at + data.draw(st.integers(1, 4))]
            case "insert":
                wire[at:at] = data.draw(st.binary(min_size=1, max_size=6))
            case "replace" if wire:
                wire[at] = data.draw(st.integers(0, 255))
    taken_or_refused(bytes(wire))


@given(ANY_MESSAGE, PLAIN, st.data())
def test_mutated_structure(message: Message, stranger: Any, data: st.DataObject) -> None:
    """A foreign value at any depth of a valid message."""
    tree = msgpack.unpackb(encode(message))
    node = tree
    while True:
        index = data.draw(st.integers(0, len(node) - 1))
        if not isinstance(node[index], list) or not node[index] or data.draw(st.booleans()):
            node[index] = stranger
            break
        node = node[index]
    taken_or_refused(msgpack.packb(tree))


@given(st.binary(max_size=100) | PLAIN.map(msgpack.packb))
def test_control_requests_are_maps_or_refused(wire: bytes) -> None:
    try:
        found = read_map(wire)
    except MalformedMessage:
        return
    assert all(isinstance(key, str) for key in found)


@given(ANY_MESSAGE, st.sets(st.sampled_from(KINDS), min_size=1))
def test_only_the_expected_kinds(message: Message, kinds: set[str]) -> None:
    """On a key only its own messages are taken: a frame on the key of commands is refused however valid it is."""
    classes = tuple(message_kinds()[kind][0] for kind in sorted(kinds))
    if isinstance(message, classes):
        assert expect(encode(message), *classes) == message
    else:
        with pytest.raises(MalformedMessage):
            expect(encode(message), *classes)
