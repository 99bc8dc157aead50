"""The kinds of payload of a log's packets."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of

from agents import compact
from agents.message import VERSION, pack
from agents.payload import StateMessage, encode
from fleet.logs.open_log import open_log
from fleet.logs.payload_kinds import DAMAGED, OTHER, STATE, KindCount, count_kinds, kind_of

MESSAGE = StateMessage(2, 20, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0))


def test_a_kind_is_the_name_that_pack_was_given() -> None:
    assert kind_of(pack("bids/1", [1, 2.5])) == "bids/1"
    assert kind_of(encode(MESSAGE)) == kind_of(compact.encode(MESSAGE, 10)) == STATE
    assert kind_of(b"") == kind_of(b"hello") == kind_of(bytes(63)) == kind_of(pack("a\nb", 1)) == OTHER


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=40), st.integers(0, 9))
def test_every_printable_kind_is_read_back(kind: str, value: int) -> None:
    assert kind_of(pack(kind, value)) == kind


@given(st.binary(max_size=80), st.booleans())
def test_any_bytes_have_a_kind_that_can_be_printed(data: bytes, ours: bool) -> None:
    assert kind_of(bytes((VERSION,)) * ours + data).isprintable()


class Packets(dict[str, Any]):
    """A link's topic, as far as it is looked at."""

    too_many = False

    def __len__(self) -> int:
        return len(self["fate"])


def test_packets_are_counted_by_kind_and_a_damaged_name_is_no_kind() -> None:
    mine, state = pack("mine", [1]), encode(MESSAGE)
    flipped, broken = b"\x81\x04minf" + mine[6:], mine[:-1] + b"\x00"
    payloads = np.array([mine, mine, state, flipped, broken], object)
    link = Packets(
        payload=payloads,
        corrupted=np.array([False, False, False, True, True]),
        fate=np.array(["delivered", "loss", "delivered", "delivered", "delivered"], object),
    )
    empty = Packets(fate=[])
    size = len(mine)
    assert count_kinds([link, empty]) == [
        KindCount("mine", 3, 1, 3 * size),
        KindCount(DAMAGED, 1, 0, size),
        KindCount(STATE, 1, 1, len(state)),
    ]
    assert count_kinds([Packets(fate=["loss"])]) is None


def test_a_run_with_a_protocol_has_two_kinds(alone: Alone) -> None:
    log = open_log(log_of(alone("average", "duration=4 s", "checks={}")), ["link/*"])
    kinds = count_kinds(map(log.__getitem__, log))
    assert {one.kind for one in kinds} == {STATE, "average/exact", DAMAGED}
    assert sum(one.packets for one in kinds) == log.messages
