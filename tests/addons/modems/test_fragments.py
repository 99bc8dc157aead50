"""Payloads in pieces: what is split is put together again, and what is incomplete never becomes a payload."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.modems.fragments import MOST_PIECES, PayloadPieces
from netem.endpoint import HeardFrame


def frame(head: bytes, data: bytes, src: int = 2) -> HeardFrame:
    return HeardFrame(src, 1, 0, data, 0, 0, 0, head)


@given(st.binary(max_size=200), st.integers(4, 64), st.integers(0, 99))
def test_the_pieces_of_a_payload_are_it_again_in_any_order(payload: bytes, room: int, seed: int) -> None:
    """The first piece comes first, as modems send one after the other."""
    pieces = PayloadPieces().split(payload, room)
    assert all(len(data) <= room for _, data in pieces) and len(pieces) <= MOST_PIECES
    first, *rest = pieces
    random.Random(seed).shuffle(rest)
    receiver = PayloadPieces()
    found = [receiver.join(frame(*piece)) for piece in (first, *rest)]
    assert found == [None] * (len(pieces) - 1) + [payload]


def test_a_piece_that_is_missing_keeps_the_payload_back_and_the_next_one_is_whole() -> None:
    sender, receiver = PayloadPieces(), PayloadPieces()
    lost, whole = sender.split(b"a" * 30, 10), sender.split(b"b" * 30, 10)
    assert [receiver.join(frame(*piece)) for piece in (lost[0], lost[2], *whole)][-1] == b"b" * 30
    assert [receiver.join(frame(*piece, src=3)) for piece in lost][-1] == b"a" * 30


def test_a_piece_that_no_modem_sends_is_none() -> None:
    assert PayloadPieces().join(frame(bytes((1, 0, 0)), b"x")) is None
    assert PayloadPieces().join(frame(bytes((1, 2, 2)), b"x")) is None


def test_numbers_come_again_and_what_never_ends_is_forgotten() -> None:
    sender, receiver = PayloadPieces(), PayloadPieces()
    for number in range(600):
        head, data = sender.split(bytes((number % 256,)) * 20, 10)[0]
        assert receiver.join(frame(head, data)) is None
    whole = sender.split(b"x" * 20, 10)
    assert [receiver.join(frame(*piece)) for piece in whole] == [None, b"x" * 20]
