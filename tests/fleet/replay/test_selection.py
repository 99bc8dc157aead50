"""Which topics are played."""

from __future__ import annotations

import pytest

from fleet.errors import FleetError
from fleet.replay.playback import chosen
from netem.wire.key_expression import matching


@pytest.mark.parametrize(
    ("text", "yes", "no"),
    [
        ("uuv/1/state", ["uuv/1/state"], ["uuv/1/state/x", "uuv/11/state"]),
        ("uuv/*/state", ["uuv/1/state", "uuv/22/state"], ["uuv/state", "uuv/1/2/state"]),
        ("uuv/**", ["uuv", "uuv/1", "uuv/1/state"], ["uuvs/1", "x/uuv"]),
        ("**/state", ["state", "uuv/1/state"], ["uuv/1/states"]),
        ("a/**/b", ["a/b", "a/x/b", "a/x/y/b"], ["a/xb", "ab"]),
        ("**", ["a", "a/b"], []),
        ("link/1-$*", ["link/1-2"], ["link/2-1"]),
        ("a.c", ["a.c"], ["abc"]),
        ("a/**/**", ["a", "a/b"], ["b"]),
        ("a//b", ["a//b"], ["a/b", "a/x/b"]),
        ("*", ["a"], ["a#", "@a"]),
        ("a#", ["a#"], ["a"]),
    ],
)  # fmt: skip
def test_patterns(text: str, yes: list[str], no: list[str]) -> None:
    assert [topic for topic in yes + no if matching(text)(topic)] == yes


def test_choice_of_topics() -> None:
    topics = ["uuv/1/state", "uuv/2/state", "link/1-2"]
    assert chosen(topics, []) == set(topics)
    assert chosen(topics, ["uuv/1/*", "link/**"]) == {"uuv/1/state", "link/1-2"}
    assert chosen(topics, [], ["uuv/**"]) == {"link/1-2"}
    assert chosen(topics, ["uuv/**"], ["/uuv/1/state"]) == {"uuv/2/state"}
    for pattern, words in (("uuv/1/stat", "uuv/1/state"), ("nothing", "there are link/1-2")):
        with pytest.raises(FleetError, match=words):
            chosen(topics, [pattern])
        with pytest.raises(FleetError, match=words):
            chosen(topics, [], [pattern])
