"""Which topics are played, and under which names."""

from __future__ import annotations

import pytest

from fleet.errors import FleetError
from fleet.replay.selection import Renaming, chosen
from netem.wire.open_bus import matching


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
    assert chosen(topics, [], None) == set(topics)
    assert chosen(topics, ["uuv/1/*"], r"-\d") == {"uuv/1/state", "link/1-2"}
    for patterns, expression, words in (
        (["uuv/1/stat"], None, "uuv/1/state"),
        (["nothing"], None, "there are link/1-2"),
        ([], "nothing", "no topic"),
        ([], "(", "no regular expression"),
    ):
        with pytest.raises(FleetError, match=words):
            chosen(topics, patterns, expression)


def test_renaming() -> None:
    rename = Renaming(["robot:=twin", "robot/1/odom:=pose", "/camera:=eye"])
    assert [rename(t) for t in ("robot/2/x", "robot/1/odom", "robots", "/camera/image")] == [
        "twin/2/x", "pose", "robots", "eye/image",
    ]  # fmt: skip
    rename.check()
    for rule in ("robot=twin", ":=x", "x:=", "x:=a//b", "x:=a/*"):
        with pytest.raises(FleetError):
            Renaming([rule])
    with pytest.raises(FleetError, match="twice"):
        Renaming(["a:=b", "/a:=c"])
