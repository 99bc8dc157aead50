"""The compact payload: what it loses is at most half a step, and what is damaged is refused."""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import agent_config
from msgspec import structs
from refusals import check_refusals

from agents.agent import Agent
from agents.compact import PER_METRE, PER_MPS, ROUNDS, SIZE, decode, encode
from agents.errors import PayloadError
from agents.payload import StateMessage
from netem.wire.messages import Delivery, Nav

M = 10  # ticks per round

states = st.builds(
    StateMessage,
    st.integers(0, 1023),
    st.integers(0, 10**7).map(lambda k: k * M),
    st.tuples(st.floats(-6553.0, 6553.0), st.floats(-6553.0, 6553.0), st.floats(-1638.0, 1638.0)),
    st.tuples(*[st.floats(-2.55, 2.55)] * 3),
)


@given(states, st.integers(0, ROUNDS * M - 1))
def test_the_error_is_at_most_half_a_step(message: StateMessage, age: int) -> None:
    data = encode(message, M)
    assert len(data) == SIZE == 15
    found = decode(data, message.sent_tick + age, M)
    assert (found.sender, found.sent_tick) == (message.sender, message.sent_tick)
    for got, sent in zip(found.position, message.position, strict=True):
        assert abs(got - sent) <= 0.5 / PER_METRE + 1e-9
    for got, sent in zip(found.velocity, message.velocity, strict=True):
        assert abs(got - sent) <= 0.5 / PER_MPS + 1e-12


@given(states)
def test_what_was_decoded_encodes_to_the_same_bytes(message: StateMessage) -> None:
    """Quantising twice loses no more than once."""
    data = encode(message, M)
    assert encode(decode(data, message.sent_tick, M), M) == data


def test_the_layout_is_the_one_in_the_table() -> None:
    message = StateMessage(3, 10 * 8195, (0.05, -0.05, 1638.35), (0.01, -0.01, 2.55))
    body = "0100000000110000000000011" + "0" * 17 + "1" + "1" * 18 + "0" + "1" * 15
    body += "000000001111111111011111111"
    expected = int(body, 2).to_bytes(13, "big")
    assert encode(message, M) == expected + crc_hqx(expected, 0xFFFF).to_bytes(2, "big")


def test_the_checksum_is_the_one_named() -> None:
    """CRC-16/CCITT with first value 0xffff of "123456789" is 0x29b1, the check value of every catalogue."""
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_every_one_or_two_flipped_bits_are_refused() -> None:
    data = encode(StateMessage(3, 120, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)), M)
    for first in range(8 * SIZE):
        for second in range(first, 8 * SIZE):
            flipped = bytearray(data)
            for bit in {first, second}:
                flipped[bit // 8] ^= 1 << bit % 8
            with pytest.raises(PayloadError) as caught:
                decode(bytes(flipped), 120, M)
            assert caught.value.cause == "checksum"


NEXT_VERSION = (2 << 102).to_bytes(13, "big")


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        *((bytes(size), "length") for size in (0, 14, 63)),
        (bytes(15), "checksum"),
        (NEXT_VERSION + crc_hqx(NEXT_VERSION, 0xFFFF).to_bytes(2, "big"), "version"),
    ],
)
def test_a_bad_payload_says_what_is_wrong(data: bytes, cause: str) -> None:
    with pytest.raises(PayloadError) as caught:
        decode(data, 0, M)
    assert caught.value.cause == cause


def test_what_does_not_fit_is_not_said() -> None:
    rest = (0.0, 0.0, 0.0)
    cases = [
        *(StateMessage(1, 0, far, rest) for far in ((6553.6, 0.0, 0.0), (0.0, -1e308, 0.0), (0.0, 0.0, 1638.4))),
        StateMessage(1, 0, rest, (0.0, -2.6, 0.0)),
        StateMessage(1024, 0, rest, rest),
    ]
    check_refusals("agents/compact messages", lambda *values: encode(StateMessage(*values), M), cases)


def compact_agent(i: int) -> Agent:
    return Agent(replace(agent_config(i, round_ticks=M), codec="compact"))


def test_agents_speak_and_understand_it() -> None:
    """The age of what was heard is that of the full message: the tick at which it was sampled."""
    one, two = compact_agent(1), compact_agent(2)
    nav = Nav(0, 0, (1.23, 4.56, 7.89, 0.0, 0.0), (0.7, 0.0, 0.0, 0.0, 0.0))
    [payload] = one.transmit(nav)
    assert len(payload) == SIZE
    two.step(structs.replace(nav, eta=(0.0,) * 5), ())
    two.step(structs.replace(nav, tick=7, eta=(0.0,) * 5), [Delivery(7, 0, 1, 0, 0, payload)])
    [heard] = two._neighbours.states_at(7)
    assert (heard.id, heard.age) == (1, 0.07)
    assert heard.velocity == (0.7, 0.0, 0.0)
    assert two.counters()["accepted"] == 1
    two.step(structs.replace(nav, tick=8, eta=(0.0,) * 5), [Delivery(8, 0, 1, 1, 0, b"\0" * 63)])
    assert two.counters()["length"] == 1


def test_a_state_beyond_the_range_is_noted_once_and_not_sent() -> None:
    one = compact_agent(1)
    far = Nav(0, 0, (7000.0, 0.0, 0.0, 0.0, 0.0), (0.0,) * 5)
    assert one.transmit(far) == ()
    assert one.transmit(structs.replace(far, tick=10)) == ()
    [(tick, text)] = one.take_notes()
    assert tick == 0
    assert "x is 7000, beyond 6553.55" in text
    assert len(one.transmit(structs.replace(far, tick=20, eta=(0.0,) * 5))) == 1
    assert one.transmit(structs.replace(far, tick=30)) == ()
    assert one.take_notes() == []
