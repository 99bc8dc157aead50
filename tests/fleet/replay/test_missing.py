"""What did not come of a journal is counted, by the places of what came and by the totals at the end."""

from __future__ import annotations

import pytest

from fleet.replay.live_journal import Missing, left_out, pack_counts


def test_gaps_and_the_end_are_counted_from_the_first_message_that_came() -> None:
    missing = Missing()
    for topic, place in (("a", 7), ("a", 8), ("b", 0), ("a", 11), ("b", 1)):
        missing.came(topic, place)
    assert (missing.lost, missing.to_come) == (2, 0)
    missing.end(pack_counts({"a": 14, "b": 3, "c": 5}))  # nothing of c was subscribed to
    assert (missing.lost, missing.to_come, missing.count) == (2, 3, 5)
    assert (missing.of("a"), missing.of("b"), missing.of("c")) == (4, 1, 0)
    missing.came("b", 2)  # it was on its way
    assert missing.of("b") == 0


def test_nothing_is_missing_while_nobody_subscribes() -> None:
    missing = Missing()
    missing.came("a", 0)
    missing.came("a", 2)
    missing.forget("a")
    missing.came("a", 9)
    assert missing.count == 1


def test_a_publisher_that_does_not_number_its_messages() -> None:
    missing = Missing()
    missing.came("a", None)
    missing.end(b"\xc1")
    missing.end(b"\x01")
    assert missing.count == 0


@pytest.mark.parametrize(("count", "words"), [(1, "1 message was left out"), (2, "2 messages were left out")])
def test_how_it_is_said(count: int, words: str) -> None:
    assert left_out(count).startswith(words)
