"""Logs whose schemas or times are damaged, by somebody who made the checksums good: told in words by every reader."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2
from huge_log import MESSAGE, chunk, record, records, text, write
from in_process_runs import Alone, log_of
from mcap.opcode import Opcode
from mcap.records import Schema
from tool import invoke

import fleet
from fleet.mcap.reader import LogReader
from fleet.mcap.records import MAGIC, parse
from fleet.mcap.recover import recover

MOST = (1 << 64) - 1
Change = Callable[[int, bytes], bytes | None]  # opcode, content: the new content; None: the record is gone


@pytest.fixture(scope="module")
def run(made: Alone) -> Path:
    asked = ["duration=2 s", "checks={signal: {topic: state.z, below: 99 m}}"]
    return log_of(made("paper", *asked, "faults=[{at: 1 s, for: 500 ms, id: crash, kill: 2}]"))


def changed(path: Path, source: Path, change: Change) -> Path:
    """A log with other records."""
    before, inside, times = b"", [], []
    for opcode, body in records(source.read_bytes()[len(MAGIC) :]):
        new = change(opcode, body)
        if new is None or opcode in (Opcode.HEADER, Opcode.MESSAGE_INDEX):
            continue
        if opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            before += record(opcode, new)
        else:
            inside.append(record(opcode, new))
            times += [MESSAGE.unpack_from(new)[2]] if opcode == Opcode.MESSAGE else []
    packed = chunk(b"".join(inside), min(times), max(times))
    return write(path, iter([(packed, len(times), min(times), max(times))]), before)


def other_schema(name: str, data: Callable[[Schema], bytes]) -> Change:
    def change(opcode: int, body: bytes) -> bytes | None:
        schema = parse(opcode, body) if opcode == Opcode.SCHEMA else None
        if not isinstance(schema, Schema) or schema.name.rpartition(".")[2] != name:
            return body
        return struct.pack("<H", schema.id) + text(schema.name) + text(schema.encoding) + text(data(schema))

    return change


def garbage(schema: Schema) -> bytes:
    return b"\xff\xff"


def with_fields(change: Callable[[descriptor_pb2.FieldDescriptorProto], None]) -> Callable[[Schema], bytes]:
    """Damage that changes each field."""

    def damage(schema: Schema) -> bytes:
        found = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
        for message in (message for file in found.file for message in file.message_type):
            for field in message.field:
                change(field)
        return found.SerializeToString()

    return damage


texts = with_fields(lambda field: setattr(field, "type", field.TYPE_STRING))
numbers = with_fields(lambda field: setattr(field, "type", field.TYPE_DOUBLE))
renamed = with_fields(lambda field: setattr(field, "name", f"q_{field.name}"))


def said(*arguments: object) -> str:
    """What a refused command says."""
    done = invoke(*arguments)
    assert done.exit_code == 2, done.output
    return done.output


@pytest.mark.parametrize("damage", [garbage, texts, renamed])
@pytest.mark.parametrize("name", ["State", "Command", "Packet"])
def test_what_if_says_which_schema(name: str, damage: Callable[[Schema], bytes], run: Path, tmp_path: Path) -> None:
    log = changed(tmp_path / "a.mcap", run, other_schema(name, damage))
    assert "the schema of" in said("whatif", log, "--agent", 3)


@pytest.mark.parametrize("damage", [garbage, numbers, renamed])
@pytest.mark.parametrize("command", [["export", "--scenario"], ["check"], ["verify", "-q"], ["whatif", "--agent", "3"]])
def test_faults_that_cannot_be_read_are_not_left_out(
    command: list[str], damage: Callable[[Schema], bytes], run: Path, tmp_path: Path
) -> None:
    log = changed(tmp_path / "a.mcap", run, other_schema("Fault", damage))
    assert "the schema of faults cannot be used" in said(command[0], log, *command[1:])


@pytest.mark.parametrize("damage", [garbage, texts])
def test_check_log_judges_no_samples_that_it_cannot_read(
    damage: Callable[[Schema], bytes], run: Path, tmp_path: Path
) -> None:
    log = changed(tmp_path / "a.mcap", run, other_schema("State", damage))
    assert "the schema of uuv/1/state cannot be used" in said("check", log)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("command", [["plot"], ["report", "--force"]])
def test_a_picture_of_what_are_no_numbers(command: list[str], run: Path, tmp_path: Path) -> None:
    log = changed(tmp_path / "a.mcap", run, other_schema("State", texts))
    found = said(command[0], log, "-o", tmp_path / "out", *command[1:])
    assert "uuv/1/state: the log's schema uuv_fleet.State cannot be used" in found


def test_check_log_says_which_link(run: Path, tmp_path: Path) -> None:
    log = changed(tmp_path / "a.mcap", run, other_schema("Packet", renamed))
    assert "the schema of link/" in said("check", log)


def test_a_time_of_foxglove_that_is_none(run: Path, tmp_path: Path) -> None:
    """Its schema says that the timestamp has other fields."""
    log = fleet.open_log(changed(tmp_path / "a.mcap", run, other_schema("PoseInFrame", renamed)))
    assert len(log["uuv/1/pose"].fields) > 0


# --- times -------------------------------------------------------------------


def stamped(number: int, log_ns: int | None, publish_ns: int | None) -> Change:
    """Another time of one message."""
    seen = iter(range(1 << 30))

    def change(opcode: int, body: bytes) -> bytes:
        if opcode != Opcode.MESSAGE or next(seen) != number:
            return body
        channel, sequence, first, second = MESSAGE.unpack_from(body)
        times = first if log_ns is None else log_ns, second if publish_ns is None else publish_ns
        return MESSAGE.pack(channel, sequence, *times) + body[MESSAGE.size :]

    return change


@pytest.mark.parametrize("number", [0, 1000])
@pytest.mark.parametrize("times", [(MOST, None), (None, MOST), (1 << 63, 1 << 63), (10**18, 10**18), (10**18, None)])
def test_a_time_that_is_none_is_damage(
    number: int, times: tuple[int | None, int | None], run: Path, tmp_path: Path
) -> None:
    """What stands before it is read; `fleet recover` keeps what stands behind it, too."""
    log = changed(tmp_path / "a.mcap", run, stamped(number, *times))
    reader = LogReader(log)
    assert sum(1 for _ in reader) == number
    assert "a message whose time is long after the end of the run (2 s)" in reader.missing
    assert reader.last_ns < 10**10
    found = recover(log)
    assert found.messages == sum(1 for _ in LogReader(run)) - 1
    assert "long after the end of the run (2 s)" in found.lost


def test_a_log_of_others_may_have_any_time_that_can_be_one(run: Path, tmp_path: Path) -> None:
    """Of such a log nobody knows how long it lasts; times since 1970 are usual."""

    def foreign(at_ns: int) -> LogReader:
        later = stamped(1000, at_ns, at_ns)
        return LogReader(
            changed(tmp_path / f"{at_ns}.mcap", run, lambda op, b: None if op == Opcode.METADATA else later(op, b))
        )

    usual = foreign(1_700_000_000 * 10**9)
    assert sum(1 for _ in usual) == sum(1 for _ in LogReader(run)) and usual.missing == ""
    none = foreign(1 << 63)
    assert sum(1 for _ in none) == 1000 and "beyond the year 2262" in none.missing


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("command", [["info"], ["plot", "--what", "formation", "-o"], ["report", "--force", "-o"]])
def test_readers_say_that_a_time_after_the_end_was_left_out(
    command: list[str], run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Axes and players had a range of 31 years."""
    monkeypatch.setattr("fleet.addons.pictures.report.WHAT", {"formation": ()})  # the others take long
    log = changed(tmp_path / "a.mcap", run, stamped(1000, 10**18, 10**18))
    done = invoke(command[0], log, *command[1:], *([tmp_path / "o"] * (len(command) > 1)))
    assert "long after the end of the run (2 s)" in " ".join(done.output.split()), done.output


def test_a_log_that_seems_to_last_a_year_is_judged_up_to_the_end_of_its_run(run: Path, tmp_path: Path) -> None:
    """Not tick by tick for a year."""
    last = sum(1 for _ in LogReader(run)) - 1
    log = changed(tmp_path / "a.mcap", run, stamped(last, 10**16, 10**16))
    done = invoke("check", log)
    assert done.exit_code in (0, 1, 2), done.output
    assert done.exception is None or isinstance(done.exception, SystemExit)
