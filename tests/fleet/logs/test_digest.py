"""The digest of a log is one SHA-256 over all its messages, in whatever pieces they are hashed."""

from __future__ import annotations

import hashlib
import struct

from hypothesis import given
from hypothesis import strategies as st

from fleet.logs.records import Digest

TIMES = st.integers(0, 2**64 - 1)
MESSAGES = st.lists(st.tuples(st.binary(max_size=5), TIMES, TIMES, st.integers(0, 2**32 - 1), st.binary(max_size=9)))


@given(MESSAGES, st.sets(st.integers(0, 50)), st.sets(st.integers(0, 50)))
def test_it_is_the_hash_of_all_parts(
    messages: list[tuple[bytes, int, int, int, bytes]], asked: set[int], joined: set[int]
) -> None:
    """Also when it was asked for in between, and when some come put together."""
    digest, whole = Digest(), b""
    for number, (topic, log_ns, publish_ns, sequence, data) in enumerate(messages):
        parts = topic + struct.pack("<QQII", log_ns, publish_ns, sequence, len(data)) + data
        if number in joined:
            digest.add_batch(parts)
        else:
            digest.add(topic, log_ns, publish_ns, sequence, data)
        whole += parts
        if number in asked:
            assert digest.hexdigest() == hashlib.sha256(whole).hexdigest()
    assert digest.hexdigest() == hashlib.sha256(whole).hexdigest()


def test_more_messages_than_are_hashed_at_once() -> None:
    digest, whole = Digest(), b""
    for number in range(2500):
        digest.add(b"t", number, number, number, b"x" * (number % 7))
        whole += b"t" + struct.pack("<QQII", number, number, number, number % 7) + b"x" * (number % 7)
    assert digest.hexdigest() == hashlib.sha256(whole).hexdigest()


def test_batches_longer_than_are_held() -> None:
    digest, whole = Digest(), b""
    for number in range(20):
        digest.add_batch(bytes([number]) * 10_000)
        whole += bytes([number]) * 10_000
    assert digest.hexdigest() == hashlib.sha256(whole).hexdigest()
