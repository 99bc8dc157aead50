"""Where a log is, and what is said when it is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer

from fleet.logs import records
from fleet.logs.reader import LogReader, LogReadError, log_path, open_file


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
    blocks = list(LogReader(log).gathered(most))
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
def chunks(draw: st.DrawFn) -> tuple[bytes, list[int]]:
    """The content of a chunk with messages, declarations and unknown records, and the places of its messages."""
    data, places = b"", []
    for number in range(draw(st.integers(1, 12))):
        kind = draw(st.sampled_from(["message", "message", "message", "channel", "unknown"]))
        if kind == "message":
            places.append(len(data))
            stamp = records.MESSAGE.pack(draw(st.integers(0, 3)), number, number, number)
            data += rec(Opcode.MESSAGE, stamp + draw(st.binary(max_size=6)))
        elif kind == "channel":
            empty = records.U32.pack(0)
            data += rec(Opcode.CHANNEL, records.U16.pack(number) + records.U16.pack(0) + empty * 3)
        else:
            data += rec(0x80, draw(st.binary(max_size=6)))
    return data, places


def seen(data: bytes, places: list[int] | None) -> list[object]:
    found: list[object] = []
    try:
        for item in records.inside(7, data, None if places is None else np.array(places, np.uint64)):
            found.append(list(item.messages()) if isinstance(item, records.Block) else item)  # noqa: PERF401 (it may raise in between)
    except records.NonsenseError:
        found.append("nonsense")
    return found


@given(st.data(), chunks())
def test_an_index_right_or_wrong_changes_nothing(choose: st.DataObject, made: tuple[bytes, list[int]]) -> None:
    data, places = made
    if choose.draw(st.booleans(), "damaged") and data:
        at = choose.draw(st.integers(0, len(data) - 1))
        data = data[:at] + bytes([choose.draw(st.integers(0, 255))]) + data[at + 1 :]
    if choose.draw(st.booleans(), "cut"):
        data = data[: choose.draw(st.integers(0, len(data)))]
    lie = choose.draw(st.lists(st.integers(0, len(data) + 40) | st.just((1 << 64) - 1), max_size=2))
    lacking = places[: choose.draw(st.integers(0, len(places)))]
    expected = seen(data, None)
    for index in (places, places[::-1], lacking, places + lie, lie):
        assert seen(data, index) == expected


def test_a_right_index_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    message = rec(Opcode.MESSAGE, records.MESSAGE.pack(1, 2, 3, 4) + b"x")
    monkeypatch.setattr(records, "_walked", None)
    (block,) = records.inside(0, message * 3, np.arange(3) * len(message))
    assert isinstance(block, records.Block)
    assert [m.data for m in block.messages()] == [b"x"] * 3
