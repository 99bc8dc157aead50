"""A log in Foxglove's viewers: what a viewer gets, and what it can do."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from foxglove_client import LIMIT_S, Viewer, viewer
from showing import Fingers, going_on
from traffic import log as log
from traffic import records as records
from waiting import wait_for

from fleet.addons.page.foxglove_log import LogBridge
from fleet.mcap.reader import Record
from fleet.mcap.seekable_log import SeekableLog
from fleet.terminal.keyboard import Key

S = 1_000_000_000


@contextmanager
def shown(log: Path, *, rate: float = 1.0, loop: bool = False) -> Iterator[tuple[Viewer, Fingers]]:
    bridge = LogBridge(SeekableLog(log), "127.0.0.1", 0, rate=rate, loop=loop)
    with closing(bridge.server), going_on(bridge.run) as fingers, viewer(bridge.server.endpoint) as found:
        yield found, fingers


def test_a_viewer_gets_the_log(log: Path, records: list[Record]) -> None:
    """All topics with the log's schemas, in simulated time; of those it subscribes to every message, byte for byte."""
    seekable = SeekableLog(log)
    topics = ("uuv/1/state", "link/1-2", "scene")
    with shown(log) as (watcher, _):
        info = watcher.infos[0]
        assert info["capabilities"] == ["time", "playbackControl"] and not watcher.services
        assert (info["dataStartTime"], info["dataEndTime"]) == ({"sec": 0, "nsec": 0}, {"sec": 2, "nsec": 0})
        for channel in seekable.channels.values():
            found, schema = watcher.channels[channel.topic], seekable.schemas[channel.schema_id]
            assert (found["encoding"], found["schemaName"]) == ("protobuf", schema.name)
            assert base64.b64decode(found["schema"]) == schema.data
        watcher.control(play=False)
        watcher.subscribe(*topics)
        watcher.control(play=True, rate=1000.0, request="on")
        watcher.until(lambda: watcher.states[-1].status == "ended")
        for topic in topics:
            expected = [(r.log_ns, r.data) for r in records if r.topic == topic]
            watcher.until(lambda topic=topic, expected=expected: len(watcher.of(topic)) >= len(expected))
            assert [(m.log_ns, m.data) for m in watcher.of(topic)] == expected
        assert {m.topic for m in watcher.messages} == set(topics)
        watcher.until(lambda: watcher.times[-1] == 2 * S)
        assert watcher.times == sorted(watcher.times)


def test_a_viewer_controls_how_a_log_is_played(log: Path, records: list[Record]) -> None:
    """Hold, seek both ways, another rate, on again at the end; each answered with the request's id."""
    states = [r for r in records if r.topic == "uuv/1/state"]
    with shown(log) as (watcher, _):
        watcher.subscribe("uuv/1/state")
        told = watcher.control(play=False, seek_ns=1 * S, request="back")
        assert told == ("paused", 1 * S, 1.0, True, "back")
        last = max((r for r in states if r.log_ns < S), key=lambda r: r.log_ns)
        watcher.until(lambda: (last.log_ns, last.data) in [m[1:] for m in watcher.messages])  # before it goes on
        count = len(watcher.messages)
        told = watcher.control(play=True, rate=100.0, request="on")
        assert told == ("playing", 1 * S, 100.0, False, "on")
        watcher.until(lambda: watcher.states[-1].status == "ended")
        watcher.until(lambda: watcher.messages[-1].log_ns == 2 * S)
        assert [m.log_ns for m in watcher.messages[count:]] == [r.log_ns for r in states if r.log_ns >= S]
        told = watcher.control(play=True, request="again")
        assert told == ("playing", 0, 1.0, True, "again")
        told = watcher.control(play=False, rate=float("nan"), seek_ns=2**60, request="far")  # to the nearer end
        assert told[:4] == ("paused", 2 * S, 1.0, True)
        assert len(watcher.infos) == 1  # the answer says that it jumped; nobody has to forget anything


def test_only_what_is_asked_for_is_decoded(log: Path, records: list[Record]) -> None:
    """A second topic comes with its last message; one that is given up comes no more; without a viewer it waits."""
    bridge = LogBridge(SeekableLog(log), "127.0.0.1", 0, rate=1.0, loop=False)
    with closing(bridge.server), going_on(bridge.run):
        with viewer(bridge.server.endpoint) as watcher:
            watcher.control(play=False, seek_ns=1 * S)
            watcher.subscribe("scene")
            watcher.until(lambda: watcher.of("scene"))
            assert watcher.of("scene")[0].log_ns == max(
                r.log_ns for r in records if r.topic == "scene" and r.log_ns < S
            )
            watcher.subscribe("uuv/2/error")
            watcher.until(lambda: watcher.of("uuv/2/error"))
            watcher.unsubscribe("scene")
            watcher.control(play=True, rate=1000.0, request="on")
            watcher.until(lambda: watcher.states[-1].status == "ended")
            watcher.until(lambda: watcher.messages[-1].log_ns == 2 * S)
            assert len(watcher.of("scene")) == 1
            assert bridge.server.sent == len(watcher.messages)
        wait_for(lambda: not bridge.server.viewers, LIMIT_S, "the viewer to leave")
        with viewer(bridge.server.endpoint) as watcher:
            watcher.subscribe("uuv/2/error")  # somebody comes after the end: it begins again
            watcher.until(lambda: watcher.of("uuv/2/error"))
            assert watcher.of("uuv/2/error")[0].log_ns < S


@pytest.mark.parametrize("how", ["loop", "keyboard"])
def test_viewers_forget_what_they_have_when_time_goes_back(how: str, log: Path) -> None:
    """A new session, and a state that says so, where the viewer did not ask for it."""
    with shown(log, rate=100.0 if how == "loop" else 1.0, loop=how == "loop") as (watcher, fingers):
        watcher.subscribe("uuv/1/state")
        watcher.until(lambda: watcher.of("uuv/1/state"))
        if how == "keyboard":
            fingers.presses.put(Key.BACK)
        watcher.until(lambda: len(watcher.infos) > 1)
        assert watcher.infos[0]["sessionId"] != watcher.infos[-1]["sessionId"]
        watcher.until(lambda: any(state.jumped for state in watcher.states))
        assert next(state for state in watcher.states if state.jumped)[:2] == ("playing", 0)


def test_the_keyboard_steps_and_holds(log: Path) -> None:
    """For viewers without controls of their own."""
    with shown(log) as (watcher, fingers):
        watcher.control(play=False, seek_ns=1 * S)
        watcher.subscribe("uuv/1/state")
        watcher.until(lambda: watcher.messages)
        fingers.presses.put(Key.STEP)
        watcher.until(lambda: watcher.messages[-1].log_ns == S)
        assert watcher.states[-1].status == "paused"
        fingers.presses.put(Key.PAUSE)
        watcher.until(lambda: watcher.states[-1].status == "playing")


def test_a_log_of_another_program_is_shown_as_well(tmp_path: Path) -> None:
    """With its own times; a topic without a schema, and one of two channels, too."""
    from fleet.mcap.writer import McapWriter

    path = tmp_path / "robot.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, "robot")
        channels = [writer.channel("odom", "json", 0, {"by": by}) for by in ("left", "right")]
        for n in range(3):
            writer.message(channels[n % 2], 1_700_000_000 * S + n, 0, n, b'{"n": %d}' % n)
        writer.finish()
    with shown(path) as (watcher, _):
        assert watcher.infos[0]["name"] == "robot.mcap"
        watcher.subscribe("odom")
        watcher.until(lambda: len(watcher.messages) == 3)
        assert watcher.messages[2] == ("odom", 1_700_000_000 * S + 2, b'{"n": 2}')
