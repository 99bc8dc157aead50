"""Logs that unpack to gigabytes, or hold huge attachments, metadata and messages, take no more memory than others."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from google.protobuf.message import DecodeError
from huge_log import HEAD, MAGIC, MESSAGE, chunk, record, tail, text
from in_process_runs import Alone, log_of
from mcap.opcode import Opcode
from small_scenario import small

from fleet.addons.page.feed import TRANSFORMS, fault_message, is_lost, take
from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.view_state import ViewState
from fleet.logs.decoder import decode_message
from fleet.mcap.reader import LogReadError
from fleet.mcap.seekable_log import SeekableLog
from netem.limits import LOG_FAULTS, LOG_MESSAGE

MIB = 1 << 20
MEMORY = 900 * MIB  # of addresses, beside the 1 GiB to which a bomb unpacks
# What each command does, in a process that may have no more memory than a log needs.
LIMITED = """
import resource, sys
from fleet.cli.main import cli
resource.setrlimit(resource.RLIMIT_DATA, ({0}, {0}))
cli(prog_name="fleet")
"""


def zeros(size: int) -> bytes:
    """So many, compressed, in a frame that does not say how many."""
    compressor = zstandard.ZstdCompressor(level=1, write_content_size=False).compressobj()
    return b"".join([*(compressor.compress(bytes(MIB)) for _ in range(size // MIB)), compressor.flush()])


def attachment(size: int) -> bytes:
    body = struct.pack("<QQ", 0, 0) + text("huge") + text("application/octet-stream") + struct.pack("<Q", size)
    return record(Opcode.ATTACHMENT, body + bytes(size) + bytes(4))


def metadata(size: int) -> bytes:
    values = text("x") + text(bytes(size))
    return record(Opcode.METADATA, text("huge") + struct.pack("<I", len(values)) + values)


STRANGE: dict[str, Callable[[], bytes]] = {
    "a chunk that says it is small": lambda: chunk(zeros(1024 * MIB), 0, 10**9, size=1000),
    "a chunk that says it is large": lambda: chunk(zeros(1024 * MIB), 0, 10**9, size=1024 * MIB),
    "a huge attachment": lambda: attachment(100 * MIB),
    "huge metadata": lambda: metadata(100 * MIB),
}


def with_record(log: Path, more: bytes, path: Path) -> Path:
    """A log with one more record at the end of its data."""
    data = log.read_bytes()
    at = len(MAGIC)
    while data[at] != Opcode.DATA_END:
        at += HEAD.size + HEAD.unpack_from(data, at)[1]
    path.write_bytes(data[:at] + more + tail(1, 0, 10**9, at + len(more)))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", STRANGE)
def test_commands_say_what_is_wrong_and_take_little_memory(kind: str, alone: Alone, tmp_path: Path) -> None:
    log = with_record(log_of(alone("paper", "duration=500 ms", "checks={}")), STRANGE[kind](), tmp_path / "a.mcap")
    for arguments in (
        ["movie", "--fps", "1", "--width", "320", "-o", "a.gif"],
        ["plot", "--what", "inputs", "-o", "p"],
    ):
        verb, *options = arguments
        command = [sys.executable, "-c", LIMITED.format(MEMORY), verb, str(log), *options]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
        assert ended.returncode in (0, 2) and "Traceback" not in ended.stderr, ended.stderr
        assert "MemoryError" not in ended.stderr
        assert ended.stderr  # what is missing, or why nothing is drawn


def test_messages_that_are_too_large_are_left_out() -> None:
    large = bytes(LOG_MESSAGE.bytes + 1)
    state = ViewState(small())
    take(state, TRANSFORMS, 0.5, large)
    take(state, "link/1-2", 0.5, large)
    take(state, "faults", 0.5, large)
    assert state.frame()["uuv"] == state.frame()["packets"] == [] and state.at_s == 0.0
    assert fault_message(large) is None and not is_lost(large)
    with pytest.raises(DecodeError, match="8388609 bytes, more than the 8388608"):
        decode_message(None, large)


def test_more_faults_than_anybody_can_look_at_are_refused(
    alone: Alone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = log_of(alone("paper", "duration=500 ms", "checks={}"))
    (number,) = (number for number, channel in SeekableLog(log).channels.items() if channel.topic == "faults")
    some = b"".join(record(Opcode.MESSAGE, MESSAGE.pack(number, k, 10**8, 10**8)) for k in range(5))
    strange = with_record(log, chunk(some, 10**8, 10**8), tmp_path / "a.mcap")
    monkeypatch.setattr("fleet.addons.page.log_feed.LOG_FAULTS", LOG_FAULTS._replace(items=4))
    with pytest.raises(LogReadError, match="more faults than are shown"):
        LogFeed(strange)
