"""A log as a tape: any message by its number, of whole files, cut ones and files of others."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from any_mcap import ANY_MCAP
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Channel, Message
from mcap.writer import CompressionType, Writer
from traffic import log as log
from traffic import records as records
from traffic import times

from fleet.mcap.reader import LogReader, LogReadError, Record, log_path
from fleet.mcap.seekable_log import Entry, SeekableLog, Track


def test_tape_holds_what_the_reader_reads(log: Path, records: list[Record]) -> None:
    """Any message by its number, forwards and backwards."""
    tape = SeekableLog(log)
    assert len(tape) == len(records) and tape.missing == ""
    for number in [*range(0, len(tape), 97), *reversed(range(0, len(tape), 89))]:
        entry, record = tape[number], records[number]
        assert (entry.channel.topic, *entry[1:4], entry.data) == (
            record.topic, record.sequence, record.log_ns, record.publish_ns, record.data
        )  # fmt: skip
    assert times(tape) == [record.log_ns for record in records]


def at_ns(n: int) -> int:
    return 1000 + 10 * n - 15 * (n % 2)


def in_order(count: int) -> list[bytes]:
    """The first messages of `other_file` in the order of their times."""
    return [b"%d" % n for n in sorted(range(count), key=at_ns)]


def other_file(path: Path, compression: CompressionType, *, chunked: bool) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2", library="somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for n in range(100):
            writer.add_message(channel, at_ns(n), b"%d" % n, 0, n)
        writer.finish()
    return path


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_tape_reads_files_of_others(tmp_path: Path, compression: CompressionType, chunked: bool) -> None:
    """Every compression, with chunks or without."""
    tape = SeekableLog(other_file(tmp_path / "x.mcap", compression, chunked=chunked))
    assert [tape[n].data for n in range(len(tape))] == in_order(100)
    assert times(tape) == sorted(times(tape)) and tape.profile == "ros2"


def test_every_cut_of_a_file_is_a_tape_or_an_error(tmp_path: Path) -> None:
    """Cut at every byte: what is complete is there, and what is missing is said; never anything else."""
    whole = other_file(tmp_path / "whole.mcap", CompressionType.ZSTD, chunked=True).read_bytes()
    path = tmp_path / "cut.mcap"
    seen = set()
    for size in range(0, len(whole), 23):
        path.write_bytes(whole[:size])
        try:
            tape = SeekableLog(path)
        except LogReadError:
            continue
        assert [tape[n].data for n in range(len(tape))] == in_order(len(tape))
        assert len(tape) == 100 or tape.missing
        seen.add(len(tape))
    assert len(seen) > 5


def test_a_flipped_byte_ends_the_tape(log: Path, tmp_path: Path) -> None:
    whole = bytearray(log.read_bytes())
    whole[len(whole) * 2 // 3] ^= 1
    path = tmp_path / "bad.mcap"
    path.write_bytes(whole)
    tape = SeekableLog(path)
    assert 0 < len(tape) < len(SeekableLog(log))
    assert "damaged" in tape.missing or "cut" in tape.missing


def row(channel: Channel, one: Message | Entry) -> tuple[object, ...]:
    log_ns, publish_ns = (one.log_ns, one.publish_ns) if isinstance(one, Entry) else (one.log_time, one.publish_time)
    return channel.topic, one.sequence, log_ns, publish_ns, one.data


@given(ANY_MCAP, st.sampled_from([1, 100, 1 << 20]), st.sampled_from([0, 1 << 20]), st.integers(0, 30))
def test_a_tape_is_in_the_order_of_log_times(
    tmp_path_factory: pytest.TempPathFactory,
    file: tuple[bytes, list[Message]],
    stretch: int,
    held: int,
    ns: int,
) -> None:
    """As the library sorts them, by whatever stretches; and so are the messages of one topic, and the last of each."""
    log = tmp_path_factory.getbasetemp() / "any.mcap"
    log.write_bytes(file[0])
    expected = sorted(file[1], key=lambda message: message.log_time)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fleet.mcap.seekable_log._STRETCH", stretch)
        patch.setattr("fleet.mcap.seekable_log._HELD", held)
        if not expected:
            with pytest.raises(LogReadError, match="holds no message"):
                SeekableLog(log)
            return
        tape = SeekableLog(log)
        rows = [row(tape.channels[one.channel_id], one) for one in expected]
        assert [row(tape[n].channel, tape[n]) for n in range(len(tape))] == rows
        assert times(tape) == [message.log_time for message in expected]
        for channel in tape.channels:
            track = Track(tape, [channel])
            its = [n for n, message in enumerate(expected) if message.channel_id == channel]
            assert [n for n, _ in track.entries(range(len(track)))] == its
            before = [n for n in its if expected[n].log_time < ns]
            assert track.before(ns) == len(before)
            assert [n for n, _ in tape.last([channel], ns)] == before[-1:]


def bag(folder: Path, parts: list[list[tuple[str, int]]]) -> None:
    """A bag of several files, each with a numbering of its own: topics and times of its messages."""
    folder.mkdir(exist_ok=True)
    names = [f"{folder.name}_{k}.mcap" for k in range(len(parts))]
    for name, part in zip(names, parts, strict=True):
        with (folder / name).open("wb") as file:
            writer = Writer(file, chunk_size=30)
            writer.start(profile="ros2", library="somebody")
            channels: dict[str, int] = {}
            for topic, log_ns in part:
                if topic not in channels:
                    schema = writer.register_schema(f"pkg/msg/{topic}", "ros2msg", topic.encode())
                    channels[topic] = writer.register_channel(f"/{topic}", "cdr", schema, {"of": topic})
                writer.add_message(channels[topic], log_ns, topic.encode(), log_ns)
            writer.finish()
    told = {"storage_identifier": "mcap", "relative_file_paths": names}
    (folder / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": told}))


MESSAGES = st.lists(st.tuples(st.sampled_from("abcd"), st.integers(0, 30)), min_size=1, max_size=12)


@given(st.lists(MESSAGES, min_size=1, max_size=12))
def test_a_split_bag_is_one_log(tmp_path_factory: pytest.TempPathFactory, parts: list[list[tuple[str, int]]]) -> None:
    """Whatever numbers its files give to their channels, and more than ten files."""
    folder = tmp_path_factory.getbasetemp() / "bag"
    shutil.rmtree(folder, ignore_errors=True)
    bag(folder, parts)
    whole = [(f"/{topic}", log_ns, topic.encode()) for part in parts for topic, log_ns in part]
    reader = LogReader(log_path(folder))
    assert [(record.topic, record.log_ns, record.data) for record in reader] == whole
    assert len({channel.topic for channel in reader.channels.values()}) == len(reader.channels) == len(reader.schemas)
    for channel in reader.channels.values():
        assert reader.schemas[channel.schema_id].data == channel.topic.strip("/").encode()
    tape = SeekableLog(log_path(folder))
    assert [(tape[n].channel.topic, tape[n].log_ns, tape[n].data) for n in range(len(tape))] == sorted(
        whole, key=lambda one: one[1]
    )
