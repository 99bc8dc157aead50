"""Where a log is, what is said when it is not there, its records, and the digest: one SHA-256 over all its messages."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from any_mcap import ANY_MCAP
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Message
from mcap.writer import Writer

from fleet.mcap import records
from fleet.mcap.digest import Digest
from fleet.mcap.reader import LogReader, LogReadError, log_path, open_file
from netem.limits import LOG_RECORD


def test_a_link_to_a_run_gives_the_run(tmp_path: Path) -> None:
    """`latest` leads elsewhere after the next run, so nothing may remember it."""
    run = tmp_path / "paper-1-20261122-120000"
    run.mkdir()
    (tmp_path / "latest").symlink_to(run.name)
    assert log_path(tmp_path / "latest") == log_path(run) == run / "run.mcap"
    (tmp_path / "elsewhere").symlink_to(run)
    assert log_path(tmp_path / "elsewhere") == run / "run.mcap"
    assert log_path(tmp_path / "some.mcap") == tmp_path / "some.mcap"


def test_a_log_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogReadError, match=r"No such file or directory; a log is an MCAP file, or the directory of a "):
        open_file(tmp_path / "latest")


@pytest.mark.parametrize("most", [1, 3000, 1 << 30])
def test_blocks_that_are_gathered_hold_the_same_messages(tmp_path: Path, most: int) -> None:
    log = tmp_path / "many.mcap"
    with log.open("wb") as file:
        writer = Writer(file, chunk_size=1000)
        writer.start()
        topics = [writer.register_channel(f"t/{k}", "", 0) for k in range(7)]
        for k in range(300):
            writer.add_message(topics[k * k % 7], k, bytes([k % 256]) * (k % 11), k, k)
        writer.finish()
    blocks = list(LogReader(log).gather_blocks(most))
    assert [one for block in blocks for one in block.messages()] == [
        one for block in LogReader(log).blocks() for one in block.messages()
    ]
    assert len(blocks) == 1 if most == 1 << 30 else len(blocks) > 1


def test_a_message_index_that_is_damaged_ends_the_reading_there(tmp_path: Path) -> None:
    """Sound ones are passed many at a time."""
    log = tmp_path / "damaged.mcap"
    with log.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, use_statistics=False)
        writer.start()
        for channel in [writer.register_channel(f"t/{k}", "", 0) for k in range(9)]:
            writer.add_message(channel, 1, b"x", 1, 1)
        writer.finish()
    data = bytearray(log.read_bytes())
    index = b"\x07" + (22).to_bytes(8, "little") + (5).to_bytes(2, "little")
    place = data.index(index) + len(index)
    data[place : place + 4] = (17).to_bytes(4, "little")
    log.write_bytes(data)
    reader = LogReader(log)
    assert len(list(reader)) == 9
    assert [(one.what, one.offset) for one in reader.damage] == [("a damaged message index", data.index(index))]


def rec(opcode: int, body: bytes) -> bytes:
    return records.HEAD.pack(opcode, len(body)) + body


@st.composite
def chunks(draw: st.DrawFn) -> bytes:
    """The content of a chunk with messages, declarations and unknown records; perhaps cut, or with a wrong byte."""
    data = b""
    for number in range(draw(st.integers(1, 12))):
        kind = draw(st.sampled_from(["message", "message", "message", "channel", "unknown"]))
        if kind == "message":
            stamp = records.MESSAGE.pack(draw(st.integers(0, 3)), number, number, number)
            data += rec(Opcode.MESSAGE, stamp + draw(st.binary(max_size=6)))
        elif kind == "channel":
            data += rec(Opcode.CHANNEL, number.to_bytes(2, "little") + bytes(14))
        else:
            data += rec(0x80, draw(st.binary(max_size=6)))
    if draw(st.booleans()):
        at = draw(st.integers(0, len(data) - 1))
        data = data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
    return data[: draw(st.just(len(data)) | st.integers(0, len(data)))]


def one_by_one(data: bytes) -> Iterator[object]:
    """The records of a chunk, each by itself; "nonsense" where they are none."""
    at = 0
    while at < len(data):
        if len(data) - at < records.HEAD.size:
            yield "nonsense"
            return
        opcode, length = records.HEAD.unpack_from(data, at)
        body, at = data[at + records.HEAD.size :][:length], at + records.HEAD.size + length
        try:
            if at > len(data) or (opcode == Opcode.MESSAGE and length < records.MESSAGE.size):
                raise ValueError
            if opcode == Opcode.MESSAGE:
                yield records.Message(*records.MESSAGE.unpack_from(body), body[records.MESSAGE.size :])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield records.parse(opcode, body)
        except records.BROKEN:
            yield "nonsense"
            return


@given(chunks(), st.sampled_from([1, 2, 65_536]))
@example(b"\x05\x16" + bytes(29) + b"\x05", 2)  # a record that is cut after its first byte
def test_records_are_found_as_one_by_one(data: bytes, at_once: int) -> None:
    found: list[object] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(records, "LOG_RECORD", LOG_RECORD._replace(items=at_once))
        try:
            for item in records.inside(7, data):
                found += item.messages() if isinstance(item, records.Block) else [item]
        except records.NonsenseError:
            found.append("nonsense")
    assert found == list(one_by_one(data))


@given(ANY_MCAP)
def test_it_reads_what_the_library_reads(
    tmp_path_factory: pytest.TempPathFactory, file: tuple[bytes, list[Message]]
) -> None:
    """Also with what the specification tells readers to ignore; and such a file is whole."""
    log = tmp_path_factory.getbasetemp() / "any.mcap"
    log.write_bytes(file[0])
    reader = LogReader(log)
    found = [message for block in reader.blocks() for message in block.messages()]
    assert found == [
        records.Message(one.channel_id, one.sequence, one.log_time, one.publish_time, one.data) for one in file[1]
    ]
    assert reader.missing == ""


@pytest.mark.parametrize("what", ["unknown", "longer", "loose"])
def test_what_is_ignored_in_files_of_others_is_damage_in_ours(what: str, tmp_path: Path) -> None:
    """A flipped bit makes such records as well."""
    found = []
    for library in ("somebody", records.LIBRARY):
        log = tmp_path / library
        with log.open("wb") as file:
            writer = Writer(file, chunk_size=1)
            writer.start("", library)
            channel = writer.register_channel("t", "", 0)
            writer.add_message(channel, 1, b"x", 1, 1)
            writer.finish()
        data = log.read_bytes()
        end = data.index(rec(Opcode.DATA_END, bytes(4)))
        more = {
            "unknown": rec(0x80, b""),
            "longer": rec(Opcode.METADATA, bytes(9)),
            "loose": rec(Opcode.MESSAGE, records.MESSAGE.pack(channel, 1, 1, 1)),
        }[what]
        log.write_bytes(data[:end] + more + data[end:])
        reader = LogReader(log)
        list(reader)
        found.append(len(reader.damage))
    assert found == [0, 1]


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
