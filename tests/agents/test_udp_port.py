"""A port of UDP for laws: what one sends, another reads, whole or not at all."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.api import Received, UdpPort
from netem.wire.messages import Delivery


def port(number: int, at: int = 9000) -> UdpPort:
    config: Any = SimpleNamespace(id=number)
    return UdpPort(config, at)


def delivered(payloads: list[bytes], src: int = 1) -> list[Delivery]:
    return [
        Delivery(due_tick=0, sent_tick=0, src=src, seq=seq, copy=0, payload=payload)
        for seq, payload in enumerate(payloads)
    ]


@given(st.binary(max_size=6000), st.sampled_from([0, 2]), st.randoms(use_true_random=False))
def test_a_datagram_arrives_in_whatever_order_its_parts_come(data: bytes, to: int, random: Any) -> None:
    payloads = port(1).send(data, to)
    assert all(len(payload) <= 1500 for payload in payloads)
    random.shuffle(payloads)
    assert list(port(2).receive(delivered(payloads))) == [Received(1, 9000, data)]
    assert list(port(2).receive(delivered(payloads[1:]))) == []
    assert list(port(2, 9001).receive(delivered(payloads))) == []
    assert list(port(3).receive(delivered(payloads))) == ([] if to else [Received(1, 9000, data)])


@given(st.binary(min_size=1, max_size=200), st.integers(0, 10**6), st.integers(1, 255))
def test_a_payload_that_the_network_has_changed_is_none(data: bytes, at: int, flip: int) -> None:
    (payload,) = port(1).send(data)
    broken = bytearray(payload)
    broken[at % len(payload)] ^= flip
    assert list(port(2).receive(delivered([bytes(broken), b"", payload]))) == [Received(1, 9000, data)]


def test_fragments_of_several_ports_and_of_a_former_life_are_not_mixed() -> None:
    """Each port counted from 1, so the beginning of one datagram and the end of another were a third one."""
    ports = [port(1), port(1, 9001), port(1)]  # the last one: the law was killed, and began again
    parts = [one.send(letter * 2000, port=9000) for one, letter in zip(ports, (b"a", b"b", b"c"), strict=True)]
    hears = port(2)
    assert list(hears.receive(delivered([begin for begin, _ in parts]))) == []
    assert [one.data for one in hears.receive(delivered([end for _, end in parts]))] == [
        letter * 2000 for letter in (b"a", b"b", b"c")
    ]


def test_what_udp_cannot_carry_is_refused() -> None:
    with pytest.raises(ValueError, match="at most 65507 bytes"):
        port(1).send(bytes(65_508))
    with pytest.raises(ValueError, match="a port of 1 to 65535, got 0"):
        port(1, 0)
    for nobody in (-1, 65_536):  # they were an OverflowError, which names no agent
        with pytest.raises(ValueError, match=f"the number of an agent, or 0 for all, got {nobody}"):
            port(1).send(b"x", nobody)
    assert len(port(1).send(bytes(65_507))) == 45
