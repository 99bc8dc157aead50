"""What is left of a log: of one whose writer was killed, whose disk was full, that was cut or damaged.

Every outcome is a clear word and an exit status: never a traceback, a hang, a wrong value or gigabytes of memory.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from huge_log import HEAD, MESSAGE, chunk
from in_process_runs import Alone, log_of
from live import LiveRun
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer
from repository import SUPPORT
from tool import invoke

from fleet.errors import FleetError
from fleet.mcap.other import Recovered
from fleet.mcap.reader import GAPS, LOST, RECOVERY, LogReader, LogReadError, Record
from fleet.mcap.records import MAGIC
from fleet.mcap.recover import recover, recovery_text
from fleet.mcap.salvage import Salvage
from netem.limits import LOG_RECORD

# Three chunks, as small as they get.
SMALL = ["vehicles=2", "duration=2.5 s", "log.every=50 ticks", "network.period=500 ms", "checks={}"]
CUT = "the file is cut: the run was killed while it was written, or it is still going on"


@pytest.fixture(scope="module")
def log(made: Alone) -> Path:
    """A whole log of three chunks."""
    return log_of(made("paper", *SMALL))


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, offset, length of the content) of the records outside chunks."""
    at = len(MAGIC)
    while at + 9 < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        yield opcode, at, length
        at += 9 + length


def chunks(data: bytes) -> list[tuple[int, int]]:
    """(offset, behind) of the chunks."""
    return [(at, at + 9 + length) for opcode, at, length in records(data) if opcode == Opcode.CHUNK]


def read(path: Path, data: bytes) -> tuple[list[Record], str]:
    """The messages of a file with these bytes, and what is missing."""
    path.write_bytes(data)
    reader = LogReader(path)
    return list(reader), reader.missing


def mended(path: Path, data: bytes) -> tuple[Recovered, list[Record], LogReader]:
    """What `fleet recover` makes of these bytes; what it writes is a file that any MCAP library reads by its index."""
    path.write_bytes(data)
    out = path.with_name("out.mcap")
    out.unlink(missing_ok=True)
    found = recover(path, out)
    if found.nothing:
        assert not out.exists()
        return found, [], LogReader(out)
    reader = LogReader(out)
    messages = list(reader)
    with out.open("rb") as file:
        indexed = make_reader(file, validate_crcs=True)
        summary = indexed.get_summary()
        assert summary.statistics.message_count == len(messages) == found.messages
    assert bool(reader.missing) == bool(found.lost)
    return found, messages, reader


# --- whole ------------------------------------------------------------------


def test_a_whole_log_comes_out_as_the_same_bytes(log: Path, tmp_path: Path) -> None:
    result = invoke("recover", log, "-o", tmp_path / "out.mcap")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.endswith("up to t = 2.5 s; nothing is lost\n")
    assert (tmp_path / "out.mcap").read_bytes() == log.read_bytes()
    again = invoke("recover", log, "-o", tmp_path / "out.mcap")
    assert (again.exit_code, again.stdout) == (2, "")
    assert "exists already" in again.stderr


def test_beside_the_log_by_default(log: Path, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(log.read_bytes())
    assert invoke("recover", tmp_path).exit_code == 0
    assert (tmp_path / "run.recovered.mcap").read_bytes() == log.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap", "run.recovered.mcap"]


# --- cut --------------------------------------------------------------------


@pytest.mark.parametrize("every", [211, pytest.param(1, marks=pytest.mark.slow)])
def test_cut_at_every_byte_of_the_last_chunk(every: int, log: Path, tmp_path: Path) -> None:
    """Reading gives every complete chunk and nothing else; only the uncut file is whole. (Behind the chunk stands what
    is only an index, at every 29th byte or more.)"""
    data = log.read_bytes()
    whole = list(LogReader(log))
    (_, behind), (begin, end) = chunks(data)[-2:]
    before = len(read(tmp_path / "a", data[:begin])[0])
    assert 0 < before < len(whole)
    for size in [*range(behind, end - 1, every), end - 1, end, *range(end + 1, len(data), max(29, every))]:
        found, missing = read(tmp_path / "a", data[:size])
        assert found == whole[: len(whole) if size >= end else before], size
        assert missing in (CUT, "the index is missing or damaged"), size
        if size < end:
            assert missing == CUT, size
    assert read(tmp_path / "a", data) == (whole, "")


@pytest.mark.parametrize("every", [499, pytest.param(97, marks=pytest.mark.slow)])
def test_recovery_of_a_cut_file(every: int, log: Path, tmp_path: Path) -> None:
    """At every so many bytes: nothing, or an indexed file with every complete chunk, its scenario, and what is lost."""
    data = log.read_bytes()
    whole = list(LogReader(log))
    ends = [behind for _, behind in chunks(data)]
    data_end = next(at for opcode, at, _ in records(data) if opcode == Opcode.DATA_END) + 13
    whole_chunks = [each + k for each in ends for k in (-1, 0, 1)]
    for size in sorted({*range(0, len(data), every), *whole_chunks, data_end - 1, data_end}):
        found, messages, reader = mended(tmp_path / "a", data[:size])
        assert found.nothing == (size < ends[0])
        if found.nothing:
            continue
        assert messages == whole[: len(messages)]
        assert (len(messages) == len(whole)) == (size >= ends[-1])
        assert reader.attachments["scenario.yaml"].startswith(b"name: paper")
        assert bool(found.lost) == (size < data_end)  # with the end of the data there nothing can be missing
        if found.lost:
            assert reader.metadata[RECOVERY][LOST] == "the end: the file is cut"
            assert reader.metadata[RECOVERY]["messages"] == str(len(messages))
        else:
            assert found.rebuilt


# --- flipped ----------------------------------------------------------------


def assert_outcome(path: Path, data: bytes, whole: list[Record]) -> None:
    """Nothing that is read is wrong, and nothing is missing without a word."""
    path.write_bytes(data)
    reader = LogReader(path)
    try:
        found = list(reader)
    except LogReadError:
        assert data[: len(MAGIC)] != MAGIC
        found = []
    else:
        assert found == whole[: len(found)]
        assert reader.missing or len(found) == len(whole)
    rescued, messages, out = mended(path, data)
    rest = iter(whole)
    assert all(message in rest for message in messages)  # in order, none twice
    assert len(messages) >= len(found)
    if len(messages) < len(whole):
        assert rescued.nothing or rescued.lost
        if not rescued.nothing and not rescued.undeclared:
            gaps = [int(number) for number in out.metadata[RECOVERY][GAPS].split()]
            place = {message: number for number, message in enumerate(whole)}
            places = [-1, *(place[message] for message in messages)]
            assert {k for k in range(len(messages)) if places[k + 1] != places[k] + 1} <= set(gaps)


@pytest.mark.slow
def test_one_flipped_bit_anywhere(log: Path, tmp_path: Path) -> None:
    """Each a single bit of another byte, all over the file; and of the framing of each record every bit."""
    data = log.read_bytes()
    whole = list(LogReader(log))
    draw = random.Random(1)
    places = [(at, draw.randrange(8)) for at in range(0, len(data), 97)]
    for opcode, at, _ in list(records(data))[:12]:
        bits = range(8) if opcode == Opcode.CHUNK else (0, 3)
        places += [(at + byte, bit) for byte in (0, 1, 2, 4, 8) for bit in bits]
    for at, bit in places:
        flipped = bytearray(data)
        flipped[at] ^= 1 << bit
        assert_outcome(tmp_path / "a", bytes(flipped), whole)


@pytest.mark.parametrize("chunked", [True, False])
def test_any_wrong_byte_in_a_file_of_others(chunked: bool, tmp_path: Path) -> None:
    """Some of them make lengths of more than 63 bits: every one is read, and is damage or none."""
    whole, path = tmp_path / "whole", tmp_path / "a"
    with whole.open("wb") as file:
        writer = Writer(file, use_chunking=chunked)
        writer.start()
        channel = writer.register_channel("t", "json", writer.register_schema("S", "", b"any"), {"key": "value"})
        writer.add_message(channel, 1, b"{}", 1)
        writer.add_attachment(1, 1, "name", "text/plain", b"text")
        writer.add_metadata("name", {"key": "value"})
        writer.finish()
    data = whole.read_bytes()
    for at in range(len(MAGIC), len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x80]) + data[at + 1 :])
        list(LogReader(path))
        with path.open("rb") as file:
            salvage = Salvage(file, beyond=True)
            assert list(salvage) or salvage.damage


def test_an_index_that_turns_into_a_message(log: Path, tmp_path: Path) -> None:
    """Which would have no CRC, and a channel that there is; in a cut file no count tells either."""
    data = bytearray(log.read_bytes())
    at = [at for opcode, at, _ in records(bytes(data)) if opcode == Opcode.MESSAGE_INDEX][-1]
    data[at] ^= Opcode.MESSAGE_INDEX ^ Opcode.MESSAGE
    assert_outcome(tmp_path / "a", bytes(data[: at + 300]), list(LogReader(log)))


def test_torn_pages(log: Path, tmp_path: Path) -> None:
    """A stretch of zeros or of noise, as a power failure leaves it, somewhere or to the end."""
    data = log.read_bytes()
    whole = list(LogReader(log))
    draw = random.Random(2)
    for _ in range(60):
        begin = draw.randrange(len(data))
        end = draw.choice([len(data), min(len(data), begin + draw.randrange(1, 2000))])
        filling = bytes(end - begin) if draw.random() < 0.5 else draw.randbytes(end - begin)
        assert_outcome(tmp_path / "a", data[:begin] + filling + data[end:], whole)


def test_recovery_goes_on_behind_a_damaged_chunk(log: Path, tmp_path: Path) -> None:
    """The first and the last second are left, what is gone is counted by the chunk's own index, and said."""
    data = bytearray(log.read_bytes())
    whole = list(LogReader(log))
    begin, end = chunks(bytes(data))[1]
    data[(begin + end) // 2] ^= 1
    found, messages, reader = mended(tmp_path / "a", bytes(data))
    gone = len(whole) - len(messages)
    (gap,) = (int(number) for number in reader.metadata[RECOVERY][GAPS].split())
    assert messages == whole[:gap] + whole[gap + gone :]
    span = f"t = {whole[gap].log_ns / 1e9:g} to {whole[gap + gone - 1].log_ns / 1e9:g} s"
    assert found.lost == f"a damaged chunk at byte {begin}, {span}, {gone} messages"
    assert reader.missing.startswith("it was recovered from a damaged file, of which this is lost: a damaged chunk")
    # Everything else stops before it.
    info = invoke("info", tmp_path / "a")
    assert (info.exit_code, f"{gap} messages" in info.stdout) == (0, True)
    assert "NOT WHOLE: a damaged chunk at byte" in info.stdout
    assert invoke("recover", tmp_path / "a", "-o", tmp_path / "b").exit_code == 3


def test_a_damaged_first_chunk(log: Path, tmp_path: Path) -> None:
    """It declares the topics: the index repeats that; without an index nobody can say what the rest is."""
    data = bytearray(log.read_bytes())
    whole = list(LogReader(log))
    data[chunks(bytes(data))[0][0] + 300] ^= 4
    found, messages, reader = mended(tmp_path / "a", bytes(data))
    assert messages == whole[-len(messages) :]
    assert (found.undeclared, reader.metadata[RECOVERY][GAPS]) == (0, "0")
    found, messages, _ = mended(tmp_path / "a", bytes(data[:-200]))
    assert found.nothing and found.undeclared > 0
    assert "messages on channels whose declaration is gone" in found.lost


def test_the_framing_is_found_again(log: Path, tmp_path: Path) -> None:
    """A length that is wrong leads astray: the next chunk is found by what it looks like."""
    data = bytearray(log.read_bytes())
    whole = list(LogReader(log))
    begin, _ = chunks(bytes(data))[1]
    data[begin + 1] ^= 0x10
    _, messages, _ = mended(tmp_path / "a", bytes(data))
    assert messages[0] == whole[0] and messages[-1] == whole[-1]
    assert 0 < len(messages) < len(whole)


# --- no logs ----------------------------------------------------------------


def foreign(path: Path, count: int = 3) -> None:
    """An MCAP of somebody else."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/chatter", "json", writer.register_schema("", "", b""))
        for k in range(count):
            writer.add_message(channel, k, b"{}", k)
        writer.finish()


def head(log: Path) -> bytes:
    """Everything before the first chunk."""
    data = log.read_bytes()
    return data[: chunks(data)[0][0]]


BAD = {
    "empty": ("", "it is empty"),
    "text": ("name: paper\n", "does not begin with MCAP's magic bytes"),
    "magic": (MAGIC, "holds no scenario"),
    "noise": (MAGIC + random.Random(3).randbytes(5000), "holds no scenario"),
    "zeros": (MAGIC + bytes(100_000), "holds no scenario"),
    "folder": (None, "No such file or directory"),
    "fifo": (None, "it is no file"),
}


def make(kind: str, folder: Path) -> Path:
    path = folder / f"{kind}.mcap"
    content = BAD[kind][0]
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_log(kind: str, log: Path, tmp_path: Path) -> None:
    """Each reader of the package: status 2 (or 1, "nothing", of recover), a sentence on stderr, nothing on stdout."""
    path = make(kind, tmp_path)
    said = BAD[kind][1]
    for command in (("export", "--scenario"), ("verify",)):
        result = invoke(*command, path)
        assert (result.exit_code, result.stdout) == (2, "")
        assert said in result.stderr
    mcap = kind in ("magic", "noise", "zeros")
    for arguments in (("info", path), ("diff", path, log, "-q"), ("diff", log, path, "-q")):
        result = invoke(*arguments)
        assert result.exit_code == (2 if not mcap else 0 if arguments[0] == "info" else 1), arguments
        assert mcap or (said in result.stderr and not result.stdout)
    result = invoke("recover", path, "-o", tmp_path / "out")
    assert result.exit_code == (2 if kind in ("folder", "fifo") else 1)
    assert result.stderr and not result.stdout
    assert not (tmp_path / "out").exists()


def test_an_mcap_that_is_not_ours(tmp_path: Path) -> None:
    """Information, recovery and comparison need no scenario; the others say that it has none."""
    path = tmp_path / "foreign.mcap"
    foreign(path)
    assert "not a log of uuv-fleet" in invoke("info", path).stdout
    for command in (("export", "--scenario"), ("verify",)):
        assert "holds no scenario: it was not written by fleet run" in invoke(*command, path).stderr
    assert invoke("diff", path, path).stdout == "the same bit for bit (3 messages)\n"
    assert invoke("recover", path, "-o", tmp_path / "out").exit_code == 0
    assert list(LogReader(tmp_path / "out")) == list(LogReader(path))


def test_a_log_of_which_only_the_head_is_left(log: Path, tmp_path: Path) -> None:
    """Killed within its first second a run leaves its scenario: it can be run again, but not compared."""
    path = tmp_path / "a"
    path.write_bytes(head(log))
    assert invoke("export", path, "--scenario").exit_code == 0
    assert "0 messages" in invoke("info", path).stdout
    result = invoke("verify", path)
    assert (result.exit_code, result.stdout) == (3, "")
    assert f"holds no message: {CUT}" in result.stderr
    assert invoke("recover", path).exit_code == 1


def lie(size: int, packed: bytes, compression: str = "zstd") -> bytes:
    """A chunk that states what it is told to."""
    return chunk(packed, 0, 0, size=size, compression=compression)


CRAFTED = {
    "no content": HEAD.pack(Opcode.CHUNK, 0),
    "an empty chunk": lie(0, b""),
    "an empty uncompressed chunk": lie(0, b"", ""),
    "a petabyte unpacked": lie(1 << 50, b"\x28\xb5\x2f\xfd\x20\x00\x01\x00\x00"),
    "a bomb": lie(LOG_RECORD.bytes, b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 45) + b"\x01\x00\x00"),
    "a petabyte packed": HEAD.pack(Opcode.CHUNK, 1 << 50) + bytes(100),
    "a petabyte of attachment": HEAD.pack(Opcode.ATTACHMENT, 1 << 50) + bytes(100),
    "more than there is": HEAD.pack(Opcode.METADATA, 100) + bytes(20),
    "lz4": lie(10, bytes(10), "lz4"),
    "an endless name": struct.pack("<BQI", Opcode.METADATA, 8, 0xFFFFFFFF) + bytes(4),
    "a message within that has no end": lie(9, HEAD.pack(Opcode.MESSAGE, 1 << 60), b""),
    "a message too short": lie(12, HEAD.pack(Opcode.MESSAGE, 3) + bytes(3), b""),
    "a message of nobody": lie(31, HEAD.pack(Opcode.MESSAGE, 22) + MESSAGE.pack(99, 0, 0, 0), b""),
    "no UTF-8": struct.pack("<BQI", Opcode.HEADER, 6, 2) + b"\xff\xfe",
    "kind 0": bytes(9),
}


@pytest.mark.parametrize("behind", [False, True], ids=["at the end", "before the rest"])
@pytest.mark.parametrize("kind", CRAFTED)
def test_crafted_records(kind: str, behind: bool, log: Path, tmp_path: Path) -> None:
    """Lengths that lie allocate nothing and lead nowhere; behind them the rest of the log is found again."""
    data = log.read_bytes()
    start = len(head(log))
    crafted = data[:start] + CRAFTED[kind] + (data[start:] if behind else b"")
    whole = list(LogReader(log))
    tracemalloc.start()
    messages, missing = read(tmp_path / "a", crafted)
    found, rescued, _ = mended(tmp_path / "a", crafted)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6
    harmless = "an empty" in kind
    assert messages == (whole if behind and harmless else [])
    assert bool(missing) == (not (behind and harmless))
    assert rescued == (whole if behind else [])
    assert found.nothing == (not behind)


def test_a_damaged_scenario_is_not_run(log: Path, tmp_path: Path) -> None:
    data = bytearray(log.read_bytes())
    at = data.index(b"seed: 1")
    data[at + 6] = ord("2")
    (tmp_path / "a").write_bytes(data)
    result = invoke("verify", tmp_path / "a")
    assert result.exit_code == 2
    assert "holds no scenario (a damaged attachment at byte" in result.stderr


# --- kill -9, full disks ----------------------------------------------------


@pytest.mark.slow
def test_a_recorder_killed_at_random_moments_loses_a_second_at_most(tmp_path: Path) -> None:
    """Fifty times. What is left is how the whole log begins, to the last full second that the recorder had taken."""
    done = subprocess.run(
        [sys.executable, str(SUPPORT / "bare_recorder.py"), str(tmp_path), "50", "1"],
        capture_output=True,
        text=True,
        timeout=280,
        check=True,
    )
    killed = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(killed) == 50
    whole = list(LogReader(tmp_path / "whole.mcap"))
    lost: list[float] = []
    for death in killed:
        path, taken_s = Path(death["log"]), death["taken_s"]
        if not path.exists() or not path.stat().st_size:  # it had not begun
            assert taken_s == 0.0
            continue
        reader = LogReader(path)
        left = list(reader)
        assert left == whole[: len(left)]
        until_s = left[-1].log_ns / 1e9 if left else 0.0
        assert until_s >= int(taken_s)
        assert reader.missing == CUT or len(left) == len(whole)
        lost.append(max(0.0, taken_s - until_s))
    print(f"{len(lost)} of 50 killed while writing; lost at most {max(lost):.2f} s, {sum(lost) / len(lost):.2f} s mean")
    assert max(lost) <= 1.0
    assert len({death["taken_s"] for death in killed}) > 20  # at many different moments


@pytest.mark.parametrize("victim", ["console", pytest.param("group", marks=pytest.mark.slow)])
def test_a_fleet_killed_leaves_a_log_that_verifies(victim: str, tmp_path: Path) -> None:
    """kill -9 of the console, or of everybody at once: what is left is reproduced to its last complete chunk."""
    with LiveRun(tmp_path / "runs", "rough-sea", "--duration", "60 s", "--speed", "5") as run:
        run.until_running(2.0)
        run.send(signal.SIGKILL, group=victim == "group")
        assert run.status() == 137
        run.until_nobody_is_left()
        logged_s = run.logged_s()
        assert logged_s >= 2.0
        result = invoke("verify", run.directory)
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith("reproduced bit for bit (")
        assert f"up to t = {logged_s:g} s of 60 s, as far as the file goes: the file is cut" in result.stdout
        assert invoke("recover", run.directory).exit_code == 3
        assert invoke("verify", run.directory / "run.recovered.mcap").exit_code == 0
        assert invoke("diff", run.log, run.directory / "run.recovered.mcap", "-q").exit_code == 0


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """No file may grow beyond this many bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_file_that_may_not_grow(tmp_path: Path) -> None:
    """Like a full disk, where nothing can be mounted: status 3, the reason, and what was written is a log."""

    with files_up_to(200_000):
        done = invoke("run", "paper", "--in-process", "-q", "--out", tmp_path)
    assert (done.exit_code, done.stdout) == (3, f"{(tmp_path / 'latest').resolve()}\n")
    assert "cannot write the log" in done.stderr and "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    result = invoke("verify", tmp_path / "latest")
    assert result.exit_code == 0, result.output
    assert "as far as the file goes" in result.stdout
    assert invoke("recover", tmp_path / "latest").exit_code == 3


def test_recovery_onto_a_full_disk(log: Path, tmp_path: Path) -> None:
    """No half of a file is left."""
    with files_up_to(1000), pytest.raises(FleetError, match="File too large"):
        recover(log, tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("until_s", "words"), [(60.5, "2 messages up to t = 60.5 s"), (1795471234.5, "up to 2026-11-23 22:00:34 UTC")]
)
def test_recorded_traffic_has_dates(until_s: float, words: str) -> None:
    assert words in recovery_text(Recovered(Path("a"), Path("b"), messages=2, until_s=until_s))
