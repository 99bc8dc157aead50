"""A log as a tape: any message by its number, of whole files, cut ones and files of others."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer
from traffic import log as log
from traffic import records as records
from traffic import times

from fleet.logs.reader import LogReadError, Record
from fleet.logs.tape import Tape


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
    for size in range(0, len(whole), 23):
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
