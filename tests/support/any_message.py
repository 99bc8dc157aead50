"""Messages of every kind, with values generated from their declarations."""

from __future__ import annotations

import re
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from fleet.addons.hosts.protocol.page import fields_of, message_kinds, records, texts
from netem.wire.messages import Message

RECORDS = records()
KINDS = sorted(message_kinds())
UINTS = st.one_of(st.integers(0, 300), st.integers(0, 2**64 - 1))
REALS = st.floats(allow_nan=False, allow_infinity=False)
OR_NIL = " or nil"
ARRAY = re.compile(r"(.*)\[(\*|(?:\.\.)?\d+)\]")


def values(wire: str) -> SearchStrategy[Any]:
    """Values that a declared wire type allows, as a message holds them."""
    if wire in RECORDS:
        return messages(RECORDS[wire])
    if wire in texts():
        return st.sampled_from([*texts()[wire]])
    if wire.endswith(OR_NIL):
        return st.none() | values(wire.removesuffix(OR_NIL))
    if match := ARRAY.fullmatch(wire):
        item, size = match.groups()
        most = 4 if size == "*" else int(size.removeprefix(".."))
        least = most if size.isdigit() else 0
        return st.lists(values(item), min_size=least, max_size=most).map(tuple)
    return {
        "uint": UINTS,
        "real": REALS,
        "bool": st.booleans(),
        "str": st.text(max_size=30),
        "bin": st.binary(max_size=100),
    }[wire]


def messages(cls: type) -> SearchStrategy[Any]:
    return st.tuples(*(values(field.wire) for field in fields_of(cls).values())).map(lambda given: cls(*given))


ANY_MESSAGE: SearchStrategy[Message] = st.sampled_from(KINDS).flatmap(lambda kind: messages(message_kinds()[kind][0]))
