"""Journals and other traffic over real zenoh on loopback: published, recorded, played again."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import select
import signal
import stat
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import mkstemp
from typing import Any

import pytest
from click.testing import CliRunner
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from mcap.writer import CompressionType, Writer
from repository import ROOT
from waiting import wait_for

from fleet.cli.main import cli
from fleet.logs.info import describe, read_info
from fleet.logs.reader import LogReader, LogReadError, Record
from fleet.logs.tape import Tape
from fleet.processes.interrupts import holding_interrupts
from fleet.processes.ports import free_port
from fleet.replay.attachment import Stamp, pack, unpack
from fleet.replay.capture import Gone, TrafficWriter
from fleet.replay.capture_format import ATTACHMENT, ENCODING, KIND, message_encoding, zenoh_encoding
from fleet.replay.playback import Replay, Wishes
from fleet.replay.selection import Renaming, SelectionError, chosen, pattern
from fleet.run.execute import Status, execute
from fleet.run.options import Options
from fleet.scenario.loading import load_scenario
from netem.errors import BusError
from netem.wire.access import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, ZenohSample, sample_of

LIMIT_S = 30.0
SHORT = ["duration=2 s", "checks={}"]


def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port(None)}"


class Command:
    """`python -m fleet ...` in the background; nothing of it is left when the `with` block ends."""

    def __init__(self, *arguments: Any, most_kib: int | None = None) -> None:
        """`most_kib`: the largest file that it may write [KiB]."""
        limit = [] if most_kib is None else ["bash", "-c", f'ulimit -f {most_kib}; exec "$@"', "bash"]
        descriptor, name = mkstemp(prefix="printed-")
        self._printed = Path(name)
        with os.fdopen(descriptor, "wb") as printed:
            self._process = subprocess.Popen(
                [*limit, sys.executable, "-m", "fleet", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.STDOUT,
            )
        self.pid = self._process.pid

    def __enter__(self) -> Command:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(10)
        self._printed.unlink()

    @property
    def printed(self) -> str:
        return self._printed.read_text("utf-8", "replace")

    def until(self, text: str) -> Command:
        """Wait until it has printed that."""
        wait_for(lambda: text in self.printed or self._process.poll() is not None, LIMIT_S, f"{text!r}")
        assert text in self.printed, self.printed
        return self

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def status(self) -> int:
        return self._process.wait(LIMIT_S)


class Ear:
    """Everything that is heard on a key expression, in order."""

    def __init__(self, bus: OpenBus, key: str) -> None:
        self.samples: list[ZenohSample] = []
        bus.subscribe(key, lambda received: self.samples.append(sample_of(received)))

    def until(self, count: int) -> list[ZenohSample]:
        wait_for(lambda: len(self.samples) >= count, LIMIT_S, f"{count} samples, {len(self.samples)} came")
        return self.samples


@contextlib.contextmanager
def session(bus: OpenBus) -> Iterator[OpenBus]:
    try:
        yield bus
    finally:
        bus.close()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of the paper's fleet."""
    out = tmp_path_factory.mktemp("runs")
    result = execute(load_scenario("paper", SHORT), Options(out, in_process=True, quiet=True))
    assert result.status is Status.PASS
    return result.directory / "run.mcap"


@pytest.fixture(scope="module")
def records(log: Path) -> list[Record]:
    return list(LogReader(log))


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


# --- the tape --------------------------------------------------------------


def times(tape: Tape) -> list[int]:
    """When each message is due."""
    return [tape.due(n) for n in range(len(tape))]


def test_tape_holds_what_the_reader_reads(log: Path, records: list[Record]) -> None:
    """Any message by its number, forwards and backwards."""
    tape = Tape(log)
    assert len(tape) == len(records) and tape.missing == ""
    for number in [*range(0, len(tape), 97), *reversed(range(0, len(tape), 89))]:
        entry, record = tape[number], records[number]
        assert (entry.channel.topic, *entry[1:4], entry.data) == (
            record.topic, record.sequence, record.log_ns, record.publish_ns, record.data
        )  # fmt: skip
    assert times(tape) == [record.log_ns for record in records]


def other_file(path: Path, compression: CompressionType, *, chunked: bool) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2", library="somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for n in range(100):
            writer.add_message(channel, 1000 + 10 * n - 15 * (n % 2), b"%d" % n, 0, n)
        writer.finish()
    return path


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_tape_reads_files_of_others(tmp_path: Path, compression: CompressionType, chunked: bool) -> None:
    """Every compression, with chunks or without. A message out of order is due with the one before it."""
    tape = Tape(other_file(tmp_path / "x.mcap", compression, chunked=chunked))
    assert [tape[n].data for n in range(len(tape))] == [b"%d" % n for n in range(100)]
    assert times(tape) == sorted(times(tape)) and tape.profile == "ros2"


def test_every_cut_of_a_file_is_a_tape_or_an_error(tmp_path: Path) -> None:
    """Cut at every byte: what is complete is there, and what is missing is said; never anything else."""
    whole = other_file(tmp_path / "whole.mcap", CompressionType.ZSTD, chunked=True).read_bytes()
    path = tmp_path / "cut.mcap"
    seen = set()
    for size in range(0, len(whole), 7):
        path.write_bytes(whole[:size])
        try:
            tape = Tape(path)
        except LogReadError:
            continue
        assert [tape[n].data for n in range(len(tape))] == [b"%d" % n for n in range(len(tape))]
        assert len(tape) == 100 or tape.missing
        seen.add(len(tape))
    assert len(seen) > 5


def test_a_flipped_byte_ends_the_tape(log: Path, tmp_path: Path) -> None:
    whole = bytearray(log.read_bytes())
    whole[len(whole) * 2 // 3] ^= 1
    path = tmp_path / "bad.mcap"
    path.write_bytes(whole)
    tape = Tape(path)
    assert 0 < len(tape) < len(Tape(log))
    assert "damaged" in tape.missing or "cut" in tape.missing


# --- topics and names ------------------------------------------------------


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
    ],
)  # fmt: skip
def test_patterns(text: str, yes: list[str], no: list[str]) -> None:
    assert [topic for topic in yes + no if pattern(text).fullmatch(topic)] == yes


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
        with pytest.raises(SelectionError, match=words):
            chosen(topics, patterns, expression)


def test_renaming() -> None:
    rename = Renaming(["robot:=twin", "robot/1/odom:=pose", "/camera:=eye"])
    assert [rename(t) for t in ("robot/2/x", "robot/1/odom", "robots", "/camera/image")] == [
        "twin/2/x", "pose", "robots", "eye/image",
    ]  # fmt: skip
    rename.check()
    for rule in ("robot=twin", ":=x", "x:=", "x:=a//b", "x:=a/*"):
        with pytest.raises(SelectionError):
            Renaming([rule])
    with pytest.raises(SelectionError, match="twice"):
        Renaming(["a:=b", "/a:=c"])


def test_topics_that_a_renaming_puts_on_one_key(log: Path) -> None:
    """They are played, with a warning; two that change places are no such thing."""
    tape = Tape(log)
    assert Replay(tape, Wishes(remap=("uuv/1:=uuv/2", "uuv/2:=uuv/1"))).note == ""
    note = Replay(tape, Wishes(remap=("uuv/1:=uuv/2",))).note
    assert note == "uuv/1/pose and uuv/2/pose are played on one key, fleet/replay/log/uuv/2/pose, and 6 more so"


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


# --- our own journals ------------------------------------------------------


@pytest.mark.parametrize("topics", [[], ["uuv/*/pose", "link/**"]])
def test_replay_gives_a_recorder_the_log(topics: list[str], log: Path, records: list[Record], tmp_path: Path) -> None:
    """Played as fast as possible and recorded: the same messages in the same order, with their times and encoding;
    and the recording, played again, is the same to a subscriber."""
    expected = [(n, r) for n, r in enumerate(records) if not topics or r.topic.endswith("/pose") or "link" in r.topic]
    path, where = tmp_path / "x.mcap", endpoint()
    choice = [word for topic in topics for word in ("--topics", topic)]
    with Command("record", "--key", "fleet/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
        with Command("replay", log, "-r", "0", "--connect", where, "--wait-for-subscribers", *choice) as player:
            assert player.status() == 0, player.printed
            assert f"played {len(expected)} messages" in player.printed
        wait_for(lambda: path.stat().st_size > 0 and len_of(path) >= 2 * len(expected), LIMIT_S, "the last message")
        recorder.send(signal.SIGINT)
        assert recorder.status() == 130, recorder.printed
        assert f"recorded {len(expected)} messages" in recorder.printed
    tape = Tape(path)
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
        with Command("replay", path, "-r", "0", "--connect", where, "--wait-for-subscribers") as player:
            heard = ear.until(len(expected))
            assert player.status() == 0
    assert [(s.payload, s.attachment) for s in heard] == [
        (r.data, pack(Stamp(r.log_ns, r.publish_ns, r.sequence, n))) for n, r in expected
    ]


def schemas_of(log: Path) -> dict[str, str]:
    """Topic -> name of its schema."""
    tape = Tape(log)
    return {channel.topic: tape.schemas[channel.schema_id].name for channel in tape.channels.values()}


def len_of(path: Path) -> int:
    try:
        return len(Tape(path))
    except LogReadError:
        return 0


def test_part_of_a_log_renamed_with_a_clock(log: Path, records: list[Record]) -> None:
    """--start-offset, --duration, --remap, --run, --clock at once, at four times the pace."""
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear, clock = Ear(bus, "fleet/demo/log/**"), Ear(bus, "fleet/demo/clock")
        options = ["-r", "4", "-s", "500 ms", "--duration", "1 s", "--topics", "uuv/2/state", "--remap", "uuv/2:=ghost"]
        with Command(
            "replay", log, "--connect", where, "--run", "demo", "--clock", "100", "--wait-for-subscribers", *options
        ) as player:
            assert player.status() == 0, player.printed
        expected = [r for r in records if r.topic == "uuv/2/state" and 500_000_000 <= r.log_ns <= 1_500_000_000]
        heard = ear.until(len(expected))
        beats = clock.until(2)
    assert [s.payload for s in heard] == [r.data for r in expected]
    assert {s.key for s in heard} == {"fleet/demo/log/ghost/state"}
    told = [Timestamp.FromString(s.payload) for s in beats]
    seconds = [t.seconds + t.nanos / 1e9 for t in told]
    assert seconds == sorted(seconds) and seconds[0] >= 0.5 and seconds[-1] == 1.5


def test_whoever_listens_can_ask_for_schemas(log: Path) -> None:
    """The descriptor set under fleet/{run}/schema/{name} is the log's."""
    tape = Tape(log)
    replay = Replay(tape, Wishes())
    with session(OpenBus.listen(where := endpoint())) as bus, session(OpenBus.connect(where)) as client:
        replay.open(bus)
        key = Keys("replay").schema("uuv_fleet.State")

        def answers() -> list[bytes]:
            replies = client._session.get(key, timeout=1.0)
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

        found = wait_for(answers, LIMIT_S, "the schema")
    assert found == [schema.data for schema in tape.schemas.values() if schema.name == "uuv_fleet.State"]


def test_loop_ends_with_ctrl_c(log: Path) -> None:
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, "fleet/**")
        with Command(
            "replay", log, "-r", "0", "--loop", "--connect", where, "--topics", "uuv/1/pose", "--wait-for-subscribers"
        ) as player:
            ear.until(3 * 201)
            player.send(signal.SIGINT)
            assert player.status() == 130
            assert "Traceback" not in player.printed and "played" in player.printed


# --- a live run ------------------------------------------------------------


@pytest.mark.parametrize("where", ["distributed", "in-process"])
def test_live_publishing_equals_the_log(where: str, log: Path, records: list[Record], tmp_path: Path) -> None:
    """From the first sample heard on, every message of the log comes once, in order, with what a replay would say;
    the log is the same as without; and the way in is private, read-only and gone afterwards."""
    arguments = ["paper", "--duration", "2 s", "--set", "checks={}", "--speed", "1", "--publish"]
    arguments += ["--in-process"] if where == "in-process" else []
    with LiveRun(tmp_path / "runs", *arguments) as run:
        path = tmp_path / "runs" / "latest" / "observe.json"
        wait_for(lambda: run.over or (path.exists() and path.stat().st_size), LIMIT_S, "observe.json")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        values = json.loads(path.read_text())
        observer = Credentials(values["user"], values["password"])
        prefix = Keys(values["run"]).prefix
        with (
            session(OpenBus.connect(values["endpoint"], observer)) as bus,
            session(OpenBus.connect(values["endpoint"], observer)) as other,
        ):
            ear, overheard = Ear(bus, f"{prefix}/log/**"), Ear(other, "**")
            other._session.put(f"{prefix}/log/uuv/1/state", b"forged")
            last = wait_for(
                lambda: next(
                    (s for s in ear.samples if s.attachment and unpack(s.attachment).number == len(records) - 1), None
                ),
                LIMIT_S,
                "the last message",
            )
        assert last.payload == records[-1].data
        with pytest.raises(BusError) as caught:
            OpenBus.connect(values["endpoint"], Credentials("observer", "guess"), timeout_ms=300)
        assert "guess" not in str(caught.value)
        assert run.status() == 0, run.printed
        run.until_nobody_is_left()
        assert run.log.read_bytes() == log.read_bytes()
        assert not path.exists()
        told = json.loads((run.directory / "result.json").read_text())["published"]
    assert told["dropped"] == 0 and told["messages"] >= len(ear.samples)
    heard = list(ear.samples)  # and nothing that an observer put
    stamps = [unpack(s.attachment or b"") for s in heard]
    first = stamps[0].number
    assert [s.number for s in stamps] == list(range(first, len(records)))
    schemas = schemas_of(log)
    for sample, stamp, record in zip(heard, stamps, records[first:], strict=True):
        assert stamp[:3] == (record.log_ns, record.publish_ns, record.sequence)
        assert sample.payload == record.data and not sample.delete
        assert sample.key == f"{prefix}/log/{record.topic}"
        assert sample.encoding == zenoh_encoding("protobuf", schemas[record.topic])
    # The wildcard was refused, because it names more than the journal; what a session says to itself never leaves it.
    assert {s.payload for s in overheard.samples} <= {b"forged"}


def test_a_subscriber_that_sleeps_does_not_hold_the_run(tmp_path: Path) -> None:
    """It is suspended from the first second on; the run goes on at its pace, ends well, and its log is the same."""
    arguments = ["paper", "--duration", "10 s", "--set", "checks={}"]
    with LiveRun(tmp_path / "runs", *arguments, "--speed", "5", "--publish") as run:
        path = tmp_path / "runs" / "latest" / "observe.json"
        wait_for(lambda: path.exists() and path.stat().st_size, LIMIT_S, "observe.json")
        directory = path.parent.resolve()
        with Command("record", "--run", directory, "-o", tmp_path / "x.mcap") as recorder:
            recorder.until("recording")
            recorder.send(signal.SIGSTOP)
            assert run.status() == 0, run.printed
        values = json.loads((directory / "result.json").read_text())
        wall, told = values["wall"], values["published"]
        assert wall["run_s"] < 10  # 2 s at its pace
        published = run.log
        assert told["dropped"] == 0  # the publisher's process never waits for a subscriber
        plain = execute(load_scenario("paper", ["duration=10 s", "checks={}"]), Options(tmp_path, True, quiet=True))
        assert (plain.directory / "run.mcap").read_bytes() == published.read_bytes()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGKILL, 137)])
def test_the_publisher_ends_with_the_run(number: signal.Signals, status: int, tmp_path: Path) -> None:
    """On Ctrl-C and on kill -9."""
    with LiveRun(tmp_path / "runs", "paper", "--speed", "1", "--publish") as run:
        run.until_running(0.5)
        assert any("fleet publisher" in " ".join(process.cmdline()) for process in run.alive())
        run.send(number)
        assert run.status() == status
        run.until_nobody_is_left()
        assert (run.directory / "observe.json").exists() is (status == 137)


# --- traffic of others -----------------------------------------------------


def test_other_traffic_comes_back_as_it_was(tmp_path: Path) -> None:
    """Puts, deletes, encodings, attachments, empty and long payloads: recorded from a robot, played, heard again."""
    path, where = tmp_path / "robot.mcap", endpoint()
    with Command("record", "--key", "robot/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
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
    tape = Tape(path)
    assert tape.missing == "" and tape.profile == "zenoh"
    assert all(before - 10**9 <= int(t) <= after + 10**9 for t in times(tape))
    # A router stamps what passes through it.
    assert all(before - 10**9 <= tape[n].publish_ns <= after + 10**9 for n in range(len(tape)))
    assert {c.metadata[KIND] for c in tape.channels.values()} == {"put", "delete", ATTACHMENT}
    assert not tape.schemas and "robot/1/odom" in describe(read_info(path))
    heard = heard_again(path, "robot/**")
    assert content(heard) == content(SAMPLES)
    heard = heard_again(path, "**", "--remap", "robot/1:=twin", "--topics", "robot/1/*")
    assert [s.key for s in heard] == [s.key.replace("robot/1", "twin") for s in SAMPLES if "robot/1" in s.key]


def heard_again(path: Path, key: str, *options: str) -> list[ZenohSample]:
    with session(OpenBus.listen(where := endpoint())) as bus:
        ear = Ear(bus, key)
        with Command("replay", path, "-r", "0", "--connect", where, "--wait-for-subscribers", *options) as player:
            assert player.status() == 0, player.printed
            count = int(re.findall(r"played (\d+) messages", player.printed)[0])
        return ear.until(count)


def test_writer_keeps_timestamps(tmp_path: Path) -> None:
    tape = Tape(traffic(tmp_path / "x.mcap", SAMPLES))
    stamped = [tape[n] for n in range(len(tape)) if tape[n].channel.topic == "robot/1/status"]
    assert stamped[1].publish_ns == 1_600_000_000_123_456_789
    assert stamped[1].log_ns == 1_700_000_000_001_000_000
    assert stamped[1].channel.message_encoding == "json"


def test_killed_recorder_loses_a_second(tmp_path: Path) -> None:
    """kill -9: what is older than a second is in the file, and the file plays."""
    path, where = tmp_path / "x.mcap", endpoint()
    with Command("record", "--key", "a/**", "-o", path, "--listen", where) as recorder:
        recorder.until("recording")
        with session(OpenBus.connect(where)) as bus:
            out = bus.publication("a/b", "zenoh/bytes", drop=False)
            wait_for(lambda: out.matched, LIMIT_S, "the recorder's subscription")
            sent: list[float] = []
            end = time.monotonic() + 2.2

            def put_until_the_end() -> bool:
                out.put(b"%d" % len(sent), None)
                sent.append(time.monotonic())
                return time.monotonic() > end

            wait_for(put_until_the_end, LIMIT_S)
            recorder.send(signal.SIGKILL)
            killed = time.monotonic()
            recorder.status()
    tape = Tape(path)
    assert "cut" in tape.missing
    assert [tape[n].data for n in range(len(tape))] == [b"%d" % n for n in range(len(tape))]
    old = sum(at < killed - 1.5 for at in sent)  # and a half, for a busy machine
    assert len(tape) >= old > 0


def test_recording_ends_by_itself(tmp_path: Path) -> None:
    """--duration and --max-size end with status 0 and a whole file."""
    done = subprocess.run(
        [sys.executable, "-m", "fleet", "record", "-k", "x", "-o", tmp_path / "a.mcap", "--duration", "100 ms"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and "recorded 0 messages" in done.stderr
    assert LogReader(tmp_path / "a.mcap").missing == ""
    where = endpoint()
    with Command("record", "-k", "x", "-o", tmp_path / "b.mcap", "--listen", where, "--max-size", "50 kB") as recorder:
        recorder.until("recording")
        put_until(where, 10_000, recorder, "recorded")
        assert recorder.status() == 0
    assert Tape(tmp_path / "b.mcap").missing == ""


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
        tape = Tape(tmp_path / "a.mcap")
        found, expected = [tape[n].data for n in range(1, len(tape), 2)], [record.data for record in written]
        assert len(found) > 100 and found == expected[: len(found)]


def test_whether_the_other_side_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection that comes back within a second was not lost."""
    now = [0.0]
    monkeypatch.setattr("fleet.replay.capture.time.monotonic", lambda: now[0])
    there = [True]
    gone = Gone(lambda: there[0])
    said = []
    for at, is_there in (
        (0.0, True),
        (1.0, False),
        (1.9, False),
        (2.0, True),
        (2.1, False),
        (3.0, False),
        (3.1, False),
    ):
        now[0], there[0] = at, is_there
        said.append(gone())
    assert said == [False] * 6 + [True]


# --- the keyboard ----------------------------------------------------------


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


@pytest.mark.parametrize("how", ["ctrl-c", "sigterm"])
def test_keys_on_a_terminal(how: str, log: Path) -> None:
    """Pause, step, rate and seek, as the line shows them; the terminal is restored, however it ends."""
    player = Typist("replay", log, "--start-paused", "--loop", "--topics", "uuv/1/pose")
    player.until(r"t = 0\.00 / 2\.00 s  paused")
    player.type(b"\x1b[C\x1b[C\x1b[C")
    player.until(r"t = 0\.02 / 2\.00 s  paused  3 messages")
    player.type(b"]")
    player.until(r"t = 2\.00 / 2\.00 s  paused  3 messages")
    player.type(b"\x1b[1;2D")
    player.until(r"t = 0\.00 / 2\.00 s  paused  3 messages")
    player.type(b"\x1b[A ")
    player.until(r"x real time of 1\.1 ")
    player.until(r"lap 2")
    if how == "ctrl-c":
        player.type(b"\x03")
        assert player.end() == 130
    else:
        os.kill(player._process.pid, signal.SIGTERM)
        assert player.end() == 130


# --- garbage ---------------------------------------------------------------


def invoke(*arguments: Any) -> tuple[int, str]:
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    assert not isinstance(result.exception, Exception) or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


GARBAGE: dict[str, Callable[[Path], Any]] = {
    "cannot read": lambda path: None,
    "it is empty": lambda path: path.write_bytes(b""),
    "magic bytes": lambda path: path.write_text("no log at all"),
    "holds no message": lambda path: path.write_bytes(b"\x89MCAP0\r\n"),
    "holds no message: the file is cut": lambda path: path.write_bytes(
        b"\x89MCAP0\r\n\x06\xff\xff\xff\xff\xff\xff\xff\xff"
    ),
}


@pytest.mark.parametrize("words", GARBAGE)
def test_what_is_no_log_is_said_to_be_none(words: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    GARBAGE[words](path)
    code, said = invoke("replay", path)
    assert code == 2 and words in said and said.startswith("fleet: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--topics", "uuv/1/stat"], "uuv/1/state"),
        (["--regex", "("], "no regular expression"),
        (["--remap", "a=b"], "OLD:=NEW"),
        (["--remap", "nothing:=b"], 'nothing is played that is called "nothing"'),
        (["--start-offset", "3 s"], "the log ends at 2 s"),
        (["--until", "1"], "without a unit"),
        (["--duration", "-1 s"], "not negative"),
        (["--rate", "-1"], "expected 0 or"),
        (["--rate", "nan"], "expected 0 or"),
        (["--run", "a/b"], "one part of a key"),
        (["--listen", "7447"], "tcp/127.0.0.1:7447"),
        (["--listen", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:1"], "either --connect or --listen"),
        (["--start-paused"], "needs a terminal"),
        (["--clock", "0"], "--clock"),
    ],
)
def test_bad_options_of_replay(arguments: list[str], words: str, log: Path) -> None:
    code, said = invoke("replay", log, *arguments)
    assert code == 2 and words in said and "playing" not in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--key 'robot/**'"),
        (["--key", "a//b"], "no key expression"),
        (["--key", "x", "--max-size", "10"], "without a unit"),
        (["--key", "x", "--max-size", "10 furlongs"], "MB"),
        (["--run", "/nowhere"], "no live run that is published"),
        (["--key", "x", "-o", "/nowhere/x.mcap"], "No such file"),
        (["--key", "x", "-o", __file__], "exists already"),
    ],
)
def test_bad_options_of_record(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, said = invoke("record", *arguments)
    assert code == 2 and words in said
    assert list(tmp_path.iterdir()) == []


def test_nobody_there(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "netem.wire.open_bus.OpenBus.connect.__func__.__kwdefaults__", {"timeout_ms": 200}, raising=False
    )
    for arguments in (["replay", log], ["record", "-k", "x", "-o", tmp_path / "x.mcap"]):
        code, said = invoke(*arguments, "--connect", endpoint())
        assert code == 3 and "nobody answers" in said and ".rs:" not in said
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_is_held_until_it_is_asked_for() -> None:
    """And what was before is back afterwards, however often it was recorded."""
    before = signal.getsignal(signal.SIGINT)
    for _ in range(2):
        with holding_interrupts() as interrupted:
            assert not interrupted()
            signal.raise_signal(signal.SIGINT)
            assert interrupted()
        assert signal.getsignal(signal.SIGINT) is before


def test_full_disk(tmp_path: Path) -> None:
    """A file that may not grow ends the recording with status 3; what was flushed is there."""
    where, path = endpoint(), tmp_path / "x.mcap"
    with Command("record", "-k", "x", "-o", path, "--listen", where, most_kib=64) as recorder:
        recorder.until("recording")
        put_until(where, 20_000, recorder, "fleet: cannot write")
        assert recorder.status() == 3
        assert "File too large" in recorder.printed and "Traceback" not in recorder.printed


# --- the page --------------------------------------------------------------

PAGE = (ROOT / "docs" / "guide" / "replay.md").read_text("utf-8")


@pytest.mark.parametrize(("number", "shows"), [(0, "application/protobuf;uuv_fleet.State"), (1, "depth = ")])
def test_subscriber_of_the_page(number: int, shows: str, log: Path, tmp_path: Path) -> None:
    """The examples run as they stand, but for the port."""
    program = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[number]
    where = endpoint()
    path = tmp_path / "listen.py"
    path.write_text(program.replace("tcp/127.0.0.1:7447", where))
    options = ["--listen", where, "--topics", "uuv/*/state", "--wait-for-subscribers", "--loop"]
    with Command("replay", log, *options) as player:
        player.until("playing")
        with subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True) as listener:
            assert listener.stdout is not None
            lines = [listener.stdout.readline() for _ in range(8)]
            listener.kill()
    assert all(shows in line for line in lines), lines
    assert {n for line in lines for n in re.findall(r"uuv/(\d)", line)} == set("1234")


def test_page_names_every_option() -> None:
    for name in ("replay", "record"):
        for option in cli.commands[name].params:
            long = [text for text in option.opts if text.startswith("--")]
            assert not long or long[0] in PAGE or long[0] == "--quiet" or long[0] == "--output", long
