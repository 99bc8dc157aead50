"""A log on zenoh again: what a subscriber, a recorder and a person at the keyboard get."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from marks import slow
from mcap.writer import Writer
from traffic import LIMIT_S, PAGE, Command, Ear, endpoint, len_of, schemas_of, session
from traffic import log as log
from traffic import records as records
from waiting import wait_for

from fleet.errors import FleetError
from fleet.mcap.reader import Record
from fleet.mcap.seekable_log import SeekableLog
from fleet.mcap.traffic import ENCODING
from fleet.processes.interrupts import holding_interrupts
from fleet.replay.capture import zenoh_encoding
from fleet.replay.playback import Replay
from fleet.replay.player import PlaybackOptions
from fleet.replay.topics import Stamp, ask_topics, pack, unpack
from fleet.terminal.keyboard import Key
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus


class Nobody:
    """A keyboard on which nobody types. Its clock stands still, and a wait moves it on."""

    def __init__(self) -> None:
        self.now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def suspended_ns(self) -> int:
        return 0

    def read(self, seconds: float) -> list[Any]:
        self.now_ns += round(seconds * 1e9)
        return []


class LateLine:
    """A status line that is due only once the player has played for a while, as without a terminal."""

    def __init__(self, clock: Nobody) -> None:
        self.shown: list[str] = []
        self._clock = clock

    def due(self) -> bool:
        return self._clock.now_ns >= 1_300_000_000

    def show(self, pieces: list[Any]) -> None:
        self.shown.append(" ".join(piece.forms[0] for piece in pieces))


def test_the_first_line_has_the_pace(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replay, nobody = Replay(SeekableLog(log), PlaybackOptions()), Nobody()
    line = LateLine(nobody)
    monkeypatch.setattr("fleet.replay.playback.time", nobody)
    with session(OpenBus.listen(endpoint())) as bus:
        replay.open(bus)
        replay.play(nobody, line)  # type: ignore[arg-type]
    pace = float(re.findall(r"([\d.]+) x real time of 1", line.shown[0])[0])
    assert pace == pytest.approx(1.0, abs=0.01), line.shown[0]


class Script(Nobody):
    """A keyboard on which keys are typed at some times [s]. It also stands for the bus, and notes what is published."""

    def __init__(self, keys: dict[float, Key], until: float) -> None:
        super().__init__()
        self.published: list[tuple[str, float]] = []
        self._keys, self._until = keys, until

    def publication(self, key: str, _: str, *, drop: bool) -> Any:
        return SimpleNamespace(put=lambda data, _: self.published.append((key, int(data) / 1e9)))

    def read(self, seconds: float) -> list[Any]:
        if self.now_ns >= self._until * 1e9:
            raise KeyboardInterrupt
        super().read(seconds)
        return [self._keys.pop(at) for at in list(self._keys) if self.now_ns >= at * 1e9]


def of_others(path: Path) -> Path:
    """Ten seconds of a robot: two latched topics with messages now and then, and one that is not latched."""
    profile = "- history: 3\n  durability: {}\n"
    latched = {"/tf_static": "", "/map": profile.format("transient_local"), "/grid": profile.format(1)}
    others = {"/odom": profile.format("volatile"), "/scan": profile.format(2)}
    seconds = {"/tf_static": [0], "/map": [1, 4], "/grid": [1, 8], "/odom": range(11), "/scan": [3]}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for topic, offered in (latched | others).items():
            channel = writer.register_channel(topic, "cdr", 0, {"offered_qos_profiles": offered})
            for second in seconds[topic]:
                at = second * 10**9
                writer.add_message(channel, at, str(at).encode(), at)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("options", "keys", "expected"),
    [
        ({}, {}, ["odom 0", "odom 1", "odom 2"]),
        ({"start_ns": 5 * 10**9}, {}, ["odom 5", "odom 6", "odom 7"]),
        ({"start_ns": 8 * 10**9, "end_ns": 9 * 10**9, "loop": True}, {}, ["odom 8", "odom 9", "odom 8", "odom 9"]),
        ({}, {0.5: Key.FORWARD}, ["odom 0", "odom 6"]),
        ({"start_ns": 2 * 10**9}, {0.5: Key.FORWARD, 1.2: Key.BACK}, ["odom 2", "odom 8", "odom 4"]),
    ],
    ids=["all", "start", "loop", "seek", "there and back"],
)
def test_what_is_latched_is_sent_after_every_jump(
    options: dict[str, Any], keys: dict[float, Key], expected: list[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """After each, a subscriber knows the last message of each latched topic, as if all had been played."""
    script = Script(dict(keys), until=2.9)
    monkeypatch.setattr("fleet.replay.playback.time", script)
    replay = Replay(SeekableLog(of_others(tmp_path / "x.mcap")), PlaybackOptions(**options))
    replay.open(script)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        replay.play(script, LateLine(Nobody()))  # type: ignore[arg-type]
    known: dict[str, float] = {}
    heard = []
    for topic, at in script.published:
        if topic == "odom":
            heard.append(f"{topic} {at:g}")
            due = {"tf_static": [0], "map": [1, 4], "grid": [1, 8]}
            last = {name: max(t for t in times if t <= at) for name, times in due.items() if times[0] <= at}
            assert known == last
        elif topic != "scan":
            known[topic] = at
    assert heard[: len(expected)] == expected
    assert ("scan", 3) not in script.published or not options.get("start_ns")


def test_topics_that_are_no_keys_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic in ("", "/", "a#1", "a*b", "x/*", "**", "/good", "also good"):
            writer.add_message(writer.register_channel(topic, "", 0), 1, b"1", 1)
        writer.finish()
    script = Script({}, 1.0)
    replay = Replay(SeekableLog(path), PlaybackOptions(speed=0.0))
    replay.open(script)  # type: ignore[arg-type]
    replay.play(script, LateLine(script))  # type: ignore[arg-type]
    assert {topic for topic, _ in script.published} == {"good", "also good"}
    assert replay.left_out == "no keys of zenoh: '', '**', '/', 'a#1', 'a*b', 'x/*'"


@pytest.mark.parametrize("topics", [["uuv/*/pose", "link/**"], *slow([])])
def test_replay_gives_a_recorder_the_log(topics: list[str], log: Path, records: list[Record], tmp_path: Path) -> None:
    """Played as fast as possible and recorded: the same messages in the same order, with their times and encoding;
    and the recording, played again, is the same to a subscriber."""
    expected = [(n, r) for n, r in enumerate(records) if not topics or r.topic.endswith("/pose") or "link" in r.topic]
    path, where = tmp_path / "x.mcap", endpoint()
    choice = [word for topic in topics for word in ("--topics", topic)]
    with Command("record", "--key", "fleet/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
        with Command("replay", log, "--speed", "0", "--connect", where, "--wait-for-subscribers", *choice) as player:
            assert player.status() == 0, player.printed
            assert f"played {len(expected)} messages" in player.printed
        wait_for(lambda: path.stat().st_size > 0 and len_of(path) >= 2 * len(expected), LIMIT_S, "the last message")
        recorder.send(signal.SIGINT)
        assert recorder.status() == 130, recorder.printed
        assert f"recorded {len(expected)} messages" in recorder.printed
    tape = SeekableLog(path)
    assert tape.missing == ""
    assert len(tape) == 2 * len(expected)
    schemas = schemas_of(log)
    for place, (number, record) in enumerate(expected):
        stamp, payload = tape[2 * place], tape[2 * place + 1]
        assert unpack(stamp.data) == (record.log_ns, record.publish_ns, record.sequence, number)
        assert payload.data == record.data
        assert payload.channel.topic == f"fleet/replay/log/{record.topic}"
        assert payload.channel.metadata[ENCODING] == zenoh_encoding("protobuf", schemas[record.topic])
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, "fleet/**")
        with Command("replay", path, "--speed", "0", "--connect", where, "--wait-for-subscribers") as player:
            heard = ear.until(len(expected))
            assert player.status() == 0
    assert [(s.payload, s.attachment) for s in heard] == [
        (r.data, pack(Stamp(r.log_ns, r.publish_ns, r.sequence, n))) for n, r in expected
    ]


def test_part_of_a_log(log: Path, records: list[Record]) -> None:
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, "fleet/replay/log/**")
        options = ["--speed", "4", "--start", "500 ms", "--end", "1500 ms", "--topics", "uuv/2/state"]
        with Command("replay", log, "--connect", where, "--wait-for-subscribers", *options) as player:
            assert player.status() == 0, player.printed
        expected = [r for r in records if r.topic == "uuv/2/state" and 500_000_000 <= r.log_ns <= 1_500_000_000]
        heard = ear.until(len(expected))
    assert [s.payload for s in heard] == [r.data for r in expected]
    assert {s.key for s in heard} == {"fleet/replay/log/uuv/2/state"}


def test_whoever_listens_can_ask_for_topics_and_schemas(log: Path) -> None:
    """The descriptor set under fleet/{run}/schema/{name} is the log's, and the topics are those that are played."""
    tape = SeekableLog(log)
    replay = Replay(tape, PlaybackOptions(topics=("uuv/1/*", "transforms")))
    with session(OpenBus.listen(where := endpoint())) as bus, session(OpenBus.connect(where)) as client:
        replay.open(bus)
        key = Keys("replay").schema("uuv_fleet.State")
        found = wait_for(lambda: client.ask(key), LIMIT_S, "the schema")
        topics = ask_topics(client, Keys("replay"))
    schemas = {schema.name: schema.data for schema in tape.schemas.values()}
    assert found == {key: schemas["uuv_fleet.State"]}
    of_topic = schemas_of(log)
    names = [topic for topic in of_topic if topic.startswith("uuv/1/") or topic == "transforms"]
    units = {channel.topic: channel.metadata["units"] for channel in tape.channels.values()}
    assert topics == {name: (of_topic[name], schemas[of_topic[name]], units[name]) for name in names}
    assert json.loads(topics["uuv/1/state"].units)["psi"][0] == "rad"


def test_nobody_and_nonsense_are_told_apart_from_topics() -> None:
    """A journal that nobody publishes, and one that is told in another form."""
    keys = Keys("replay")
    with session(OpenBus.listen(where := endpoint())) as bus, session(OpenBus.connect(where)) as client:
        with pytest.raises(FleetError, match="is the run over, or of an older version"):
            ask_topics(client, keys)
        bus.answer(keys.topics, {keys.topics: b"\xc1"})
        wait_for(lambda: client.ask(keys.topics), LIMIT_S, "an answer")
        with pytest.raises(FleetError, match="not told as expected"):
            ask_topics(client, keys)


def test_loop_ends_with_ctrl_c(log: Path) -> None:
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, "fleet/**")
        options = ["--speed", "0", "--loop", "--topics", "uuv/1/pose", "--wait-for-subscribers"]
        with Command("replay", log, *options, "--connect", where) as player:
            ear.until(3 * 201)
            player.send(signal.SIGINT)
            assert player.status() == 130
            assert "Traceback" not in player.printed and "played" in player.printed


class Typist:
    """A replay on a terminal of its own."""

    def __init__(self, *arguments: Any) -> None:
        self.master, terminal = pty.openpty()
        self.before = termios.tcgetattr(terminal)
        self.terminal = terminal
        self._process = subprocess.Popen(
            [sys.executable, "-c", _ON_TERMINAL, *map(str, arguments)],
            stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True,
        )  # fmt: skip
        self.seen = ""

    def until(self, expression: str) -> re.Match[str]:
        """Wait until the screen has shown that after what was waited for before."""

        def look() -> re.Match[str] | None:
            if select.select([self.master], [], [], 0)[0]:
                self.seen += os.read(self.master, 65536).decode("utf-8", "replace")
            return re.search(expression, self.seen)

        found = wait_for(look, LIMIT_S, f"{expression!r} in {self.seen[-300:]!r}")
        self.seen = self.seen[found.end() :]
        return found

    def type(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def end(self) -> int:
        code = self._process.wait(LIMIT_S)
        assert termios.tcgetattr(self.terminal) == self.before, "the terminal is left as it was found"
        os.close(self.master)
        os.close(self.terminal)
        return code


# A new session has no terminal until it takes one; then Ctrl-C reaches it as from any terminal.
_ON_TERMINAL = """
import fcntl, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
sys.argv[0] = "fleet"
from fleet.__main__ import main
main()
"""


@pytest.mark.parametrize("how", ["ctrl-c", *slow("sigterm")])
def test_keys_on_a_terminal(how: str, log: Path) -> None:
    """Pause, step, rate and seek, as the line shows them; the terminal is restored, however it ends."""
    player = Typist("replay", log, "--step", "--loop", "--topics", "uuv/1/pose")
    player.until(r"t = 0\.00 / 2\.00 s  paused")
    player.type(b"\x1b[C\x1b[C\x1b[C")
    player.until(r"t = 0\.02 / 2\.00 s  paused  3 messages")
    player.type(b"]")
    player.until(r"t = 2\.00 / 2\.00 s  paused  3 messages")
    player.type(b"\x1b[1;2D")
    player.until(r"t = 0\.00 / 2\.00 s  paused  3 messages")
    player.type(b"\x1b[A ")
    player.until(r"x real time of 1\.1 ")
    player.type(b"]")
    player.until(r"lap 2")
    if how == "ctrl-c":
        player.type(b"\x03")
    else:
        os.kill(player._process.pid, signal.SIGTERM)
    assert player.end() == 130


def test_an_interrupt_is_held_until_it_is_asked_for() -> None:
    """And what was before is back afterwards, however often it was recorded."""
    before = signal.getsignal(signal.SIGINT)
    for _ in range(2):
        with holding_interrupts() as interrupted:
            assert not interrupted()
            signal.raise_signal(signal.SIGINT)
            assert interrupted()
        assert signal.getsignal(signal.SIGINT) is before


@pytest.fixture(scope="module")
def played(log: Path) -> Iterator[str]:
    """Where a log is played again and again."""
    where = endpoint()
    options = ["--listen", where, "--topics", "uuv/*/state", "--wait-for-subscribers", "--loop"]
    with Command("replay", log, *options) as player:
        player.until("playing")
        yield where


@pytest.mark.parametrize(("number", "shows"), [(0, "application/protobuf;uuv_fleet.State"), (1, "depth = ")])
def test_subscriber_of_the_page(number: int, shows: str, played: str, tmp_path: Path) -> None:
    """The examples run as they stand, but for the port."""
    program = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[number]
    path = tmp_path / "listen.py"
    path.write_text(program.replace("tcp/127.0.0.1:7447", played))
    with subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        lines = [listener.stdout.readline() for _ in range(8)]
        listener.kill()
    assert all(shows in line for line in lines), lines
    assert {n for line in lines for n in re.findall(r"uuv/(\d)", line)} == set("1234")
