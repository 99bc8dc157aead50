"""Other traffic, recorded and played again as it was."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from spawned import fleet
from traffic import LIMIT_S, Command, Ear, endpoint, len_of, session, times
from waiting import wait_for

import fleet as fleet_api
from fleet.logs.info import info_text, read_info
from fleet.mcap.reader import LogReader
from fleet.mcap.seekable_log import SeekableLog
from fleet.mcap.traffic import ATTACHMENT, KIND
from fleet.replay import capture
from fleet.replay.capture import PublisherGone, TrafficWriter, message_encoding, zenoh_encoding
from fleet.replay.topics import Stamp, pack, unpack
from netem.wire.key_expression import matching
from netem.wire.open_bus import OpenBus, ZenohSample


def traffic(path: Path, samples: list[ZenohSample], every_ns: int = 1_000_000) -> Path:
    writer = TrafficWriter(path, ["**"])
    for n, sample in enumerate(samples):
        writer.add(sample, 1_700_000_000_000_000_000 + n * every_ns)
    writer.close()
    return path


SAMPLES = [
    ZenohSample("robot/1/odom", b"\x00\x01", False, "application/cdr;nav_msgs/msg/Odometry", None, None),
    ZenohSample("robot/1/status", b'{"ok": true}', False, "application/json", b"seq=1", 1_600_000_000_123_456_789),
    ZenohSample("robot/2/odom", b"", False, "zenoh/bytes", None, None),
    ZenohSample("robot/1/status", b"", True, "zenoh/bytes", b"bye", None),
    ZenohSample("robot/2/blob", bytes(200_000), False, "image/png", b"", None),
    ZenohSample("robot/1/odom", b"\x02", False, "application/cdr;nav_msgs/msg/Odometry", None, None),
    ZenohSample("robot/1/status", b"text", False, "text/plain", None, None),
]


def put_until(where: str, size: int, recorder: Command, said: str) -> None:
    """Put samples of so many bytes until the recorder says something."""
    with session(OpenBus.connect(where)) as bus:
        out = bus.publication("x", "zenoh/bytes", drop=False)

        def it_says() -> bool:
            out.put(os.urandom(size), None)
            return said in recorder.printed

        wait_for(it_says, LIMIT_S, "the end of the recording")


def content(samples: list[ZenohSample]) -> list[tuple[Any, ...]]:
    """All but zenoh's timestamps, which a router sets anew."""
    return [(s.key, s.payload, s.delete, s.encoding, s.attachment) for s in samples]


@given(st.tuples(*[st.integers(0, 2**64 - 1)] * 4))
def test_stamp_round_trip(values: tuple[int, int, int, int]) -> None:
    assert unpack(pack(Stamp(*values))) == values


@given(st.binary(max_size=40))
def test_no_attachment_of_others_is_a_stamp_by_accident(data: bytes) -> None:
    try:
        stamp = unpack(data)
    except ValueError:
        return
    assert all(value >= 0 for value in stamp)


def test_encodings() -> None:
    assert zenoh_encoding("protobuf", "uuv_fleet.State") == "application/protobuf;uuv_fleet.State"
    assert zenoh_encoding("", "") == "zenoh/bytes"
    assert message_encoding("text/json") == "json"
    # To MCAP these mean "decode with the schema", and there is none.
    assert message_encoding("application/protobuf;x.Y") == "application/protobuf;x.Y"


def test_other_traffic_comes_back_as_it_was(tmp_path: Path) -> None:
    """Puts, deletes, encodings, attachments, empty and long payloads: recorded from a robot, played, heard again."""
    path, where = tmp_path / "robot.mcap", endpoint()
    with Command("record", "--key", "robot/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
        recorder.until("leave out parts that begin with @")
        with session(OpenBus.connect(where)) as robot:
            outs = {
                (s.key, s.encoding): robot.publication(s.key, s.encoding, drop=False) for s in SAMPLES if not s.delete
            }
            wait_for(lambda: all(out.matched for out in outs.values()), LIMIT_S, "the recorder's subscription")
            before = time.time_ns()  # noqa: TID251
            for s in SAMPLES:
                if s.delete:
                    robot._session.delete(s.key, attachment=s.attachment)
                else:
                    outs[s.key, s.encoding].put(s.payload, s.attachment)
            wait_for(lambda: len_of(path) >= len(SAMPLES), LIMIT_S, "the samples in the file")
            after = time.time_ns()  # noqa: TID251
        recorder.send(signal.SIGTERM)
        assert recorder.status() == 130, recorder.printed
    tape = SeekableLog(path)
    assert tape.missing == "" and tape.profile == "zenoh"
    assert all(before - 10**9 <= int(t) <= after + 10**9 for t in times(tape))
    # A router stamps what passes through it.
    assert all(before - 10**9 <= tape[n].publish_ns <= after + 10**9 for n in range(len(tape)))
    assert {c.metadata[KIND] for c in tape.channels.values()} == {"put", "delete", ATTACHMENT}
    assert not tape.schemas and "robot/1/odom" in info_text(read_info(path))
    heard = heard_again(path, "robot/**")
    assert content(heard) == content(SAMPLES)
    heard = heard_again(path, "**", "--topics", "robot/1/*")
    assert [s.key for s in heard] == [s.key for s in SAMPLES if "robot/1" in s.key]


def heard_again(path: Path, key: str, *options: str) -> list[ZenohSample]:
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, key)
        with Command("replay", path, "--speed", "0", "--connect", where, "--wait-for-subscribers", *options) as player:
            assert player.status() == 0, player.printed
            count = int(re.findall(r"played (\d+) messages", player.printed)[0])
        return ear.until(count)


def test_writer_keeps_timestamps(tmp_path: Path) -> None:
    tape = SeekableLog(traffic(tmp_path / "x.mcap", SAMPLES))
    stamped = [tape[n] for n in range(len(tape)) if tape[n].channel.topic == "robot/1/status"]
    assert stamped[1].publish_ns == 1_600_000_000_123_456_789
    assert stamped[1].log_ns == 1_700_000_000_001_000_000
    assert stamped[1].channel.message_encoding == "json"


def test_what_is_older_than_a_second_is_in_the_file(tmp_path: Path) -> None:
    writer = TrafficWriter(tmp_path / "x.mcap", ["**"])
    for n, at_ms in enumerate((5_000, 5_001, 5_999, 6_000, 6_001)):
        writer.add(ZenohSample("a", b"%d" % n, False, "zenoh/bytes", None, None), at_ms * 1_000_000)
    assert len_of(tmp_path / "x.mcap") == 4
    writer.close()
    assert len_of(tmp_path / "x.mcap") == 5


@pytest.mark.slow
def test_the_file_of_a_killed_recorder_plays(tmp_path: Path) -> None:
    """kill -9: what was in the file is there, in order and without gaps."""
    path, where = tmp_path / "x.mcap", endpoint()
    with Command("record", "--key", "a/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
        with session(OpenBus.connect(where)) as bus:
            out = bus.publication("a/b", "zenoh/bytes", drop=False)
            wait_for(lambda: out.matched, LIMIT_S, "the recorder's subscription")
            written = [0]
            numbers = count()

            def put_until_it_has_grown_twice() -> bool:
                out.put(b"%d" % next(numbers), None)
                if (now := len_of(path)) > written[-1]:
                    written.append(now)
                return len(written) > 2

            wait_for(put_until_it_has_grown_twice, LIMIT_S)
            recorder.send(signal.SIGKILL)
            recorder.status()
    tape = SeekableLog(path)
    assert "cut" in tape.missing
    assert [tape[n].data for n in range(len(tape))] == [b"%d" % n for n in range(len(tape))]
    assert len(tape) >= written[-1]


def test_recording_ends_by_itself(tmp_path: Path) -> None:
    """--duration ends with status 0 and a whole file."""
    done = fleet("record", "-k", "x", "-o", tmp_path / "a.mcap", "--duration", "100 ms")
    assert done.returncode == 0 and "recorded 0 messages" in done.stderr
    assert LogReader(tmp_path / "a.mcap").missing == ""


def test_recording_of_a_run_ends_with_it(tmp_path: Path) -> None:
    """The run waits for the recorder, so the beginning is there, and the recorder notices the end by itself.

    What is still on the way after two seconds more may be missing at the end, on a machine that is busy with others.
    """
    arguments = ["paper", "--duration", "1 s", "--set", "checks={}", "--in-process", "--publish"]
    with LiveRun(tmp_path / "runs", *arguments, "--wait-for-subscribers") as run:
        latest = tmp_path / "runs" / "latest"
        path = latest / "observe.json"
        wait_for(lambda: run.over or (path.exists() and path.stat().st_size), LIMIT_S, "observe.json")
        with Command("record", "--run", latest, "-o", tmp_path / "a.mcap") as recorder:
            assert recorder.status() == 0, recorder.printed
            assert "the run is over" in recorder.printed
        wait_for(lambda: run.over, LIMIT_S, "the end of the run")
        written = LogReader(run.directory / "run.mcap")
        # It is a log of the run: the same messages at the same times, each once, and all that commands need.
        found, expected = list(LogReader(tmp_path / "a.mcap")), list(written)
        assert len(found) > 100 and found == expected[: len(found)]
        told, log = read_info(tmp_path / "a.mcap"), fleet_api.open_log(tmp_path / "a.mcap")
        assert told.messages == len(found) == log.messages and told.run == read_info(run.directory / "run.mcap").run
        assert log.scenario.name == "paper" and log["uuv/1/state"].units["x"] == "m"
        assert set(fleet_api.plot(log, "error")) == {"error", "formation"}


def test_an_attachment_is_no_message_of_its_own(tmp_path: Path) -> None:
    """`info` and `open_log` counted it, and mixed it with the payloads of its topic."""
    path = traffic(tmp_path / "a.mcap", [sample for sample in SAMPLES if not sample.delete])
    told, log = read_info(path), fleet_api.open_log(path)
    assert told.messages == log.messages == 6
    assert {topic: count for topic, (_, count) in told.topics.items()} == {
        "robot/1/odom": 2, "robot/1/status": 2, "robot/2/odom": 1, "robot/2/blob": 1,
    }  # fmt: skip
    assert log["robot/1/status"].data.tolist() == [b'{"ok": true}', b"text"]


def test_what_readers_would_not_take_is_left_out_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The longest message that is recorded can be read again. Before, a longer one was lost without a word."""
    monkeypatch.setattr(capture, "sample_of", lambda sample: sample)
    heard = list[Callable[[Any], None]]()
    recorder = capture.Recorder(SimpleNamespace(subscribe=lambda _key, handler: heard.append(handler)), ["a"])
    writer = TrafficWriter(tmp_path / "x.mcap", ["a"])
    for length, attached in ((capture.MOST_MESSAGE, 0), (capture.MOST_MESSAGE + 1, 0), (1, capture.MOST_MESSAGE + 2)):
        heard[0](ZenohSample("a", bytes(length), False, "zenoh/bytes", bytes(attached) or None, None))
    recorder.finish(writer)
    assert (recorder.too_long, writer.samples) == (2, 1)
    assert "2, the longest has 65 MB, on a;" in recorder.left_out
    records = LogReader(tmp_path / "x.mcap")
    assert [len(record.data) for record in records] == [capture.MOST_MESSAGE] and records.missing == ""


PARTS = st.lists(st.sampled_from(["a", "b", "@v0", "*", "**"]), min_size=1, max_size=3).map("/".join)


@given(st.lists(PARTS, min_size=1, max_size=4), st.lists(st.sampled_from(["a", "a/b", "a/a/b", "@v0/a", "b/@v0"])))
def test_what_several_keys_include_is_recorded_once(keys: list[str], put: list[str]) -> None:
    """Zenoh delivers a sample to every subscriber whose key includes it."""
    heard = list[tuple[str, Callable[[Any], None]]]()
    bus = SimpleNamespace(subscribe=lambda key, handler: heard.append((key, handler)))
    found = list[str]()
    writer = SimpleNamespace(add=lambda sample, _: found.append(sample.key), close=lambda: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(capture, "sample_of", lambda sample: sample)
        recorder = capture.Recorder(bus, keys)
        for key in put:
            for expression, handler in heard:
                if matching(expression)(key):
                    handler(ZenohSample(key, b"x", False, "zenoh/bytes", None, None))
        recorder.finish(writer)
    assert found == [key for key in put if any(matching(expression)(key) for expression in keys)]


def test_whether_the_other_side_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection that comes back within a second was not lost."""
    now = [0.0]
    monkeypatch.setattr("fleet.replay.capture.time.monotonic", lambda: now[0])
    there = [True]
    gone = PublisherGone(lambda: there[0])
    said = []
    for now[0] in (0.0, 1.0, 1.9, 2.0, 2.1, 3.0, 3.1):
        there[0] = now[0] in (0.0, 2.0)
        said.append(gone())
    assert said == [False] * 6 + [True]


def test_full_disk(tmp_path: Path) -> None:
    """A file that may not grow ends the recording with status 3; what was flushed is there."""
    where, path = endpoint(), tmp_path / "x.mcap"
    limited = ["bash", "-c", 'ulimit -f 64; exec "$@"', "bash"]
    with Command("record", "-k", "x", "-o", path, "--listen", where, before=limited) as recorder:
        recorder.until("recording")
        put_until(where, 20_000, recorder, "fleet: cannot write")
        assert recorder.status() == 3
        assert "File too large" in recorder.printed and "Traceback" not in recorder.printed
