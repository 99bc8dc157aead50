"""A log is verified by running it again, and two logs are compared: what is the same, what is not, and by how much."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from math import inf, nan
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from failing_laws import NAN_IN_THE_CORE
from in_process_runs import recorded
from live import LiveRun
from marks import slow
from mcap.records import Attachment, Metadata
from tool import invoke
from tool import tool as op
from waiting import wait_for

import fleet.logs.deviation
from agents.controllers import TRACKING
from fleet.cores import machine
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import Wiring
from fleet.logs.decoder import Decoder
from fleet.logs.deviation import compare
from fleet.mcap.other import Recovered
from fleet.mcap.reader import LogReader, open_file
from fleet.mcap.records import Block, Message
from fleet.mcap.recover import Copy, recover
from fleet.mcap.salvage import Item, Salvage
from fleet.repeat.resume import continuation
from fleet.repeat.verify import Verification, verification_lines, verify
from fleet.result.file import write_result
from fleet.result.result import Result, Status, Wall

Part = Item | Message
ROUGH = "network.links={'*': 'delay 200ms 50ms loss 30%'}"


def run(out: Path, scenario: str, *overrides: str) -> Path:
    """The log of a run in this process."""
    result = recorded(out, scenario, "checks={tumbled: waived}", *overrides)
    assert result.status is Status.PASS, (result.reason, result.lines)
    return result.directory / "run.mcap"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("log"), "paper", "duration=2.5 s", ROUGH, "log.every=10 ticks")


def altered(log: Path, out: Path, change: Callable[[int, Part], Part | None]) -> Path:
    """A copy of a log, each item changed, or left out; messages are numbered, everything else is -1."""
    number = 0
    with open_file(log) as source, out.open("wb") as target:
        copy = Copy(target, Recovered(log, out))
        for item in (part for found in Salvage(source) for part in parts(found)):
            is_message = isinstance(item, Message)
            changed = change(number if is_message else -1, item)
            number += is_message
            if isinstance(changed, Message):
                copy.message(changed)
            elif changed is not None and not isinstance(changed, Block):
                copy.take(changed)
        copy.finish({})
    return out


def parts(item: Item) -> list[Part]:
    """The same, a block as its messages."""
    return list(item.messages()) if isinstance(item, Block) else [item]


def at(number: int, change: Callable[[Message], Message | None]) -> Callable[[int, Part], Part | None]:
    """A change of one message."""
    return lambda n, item: change(item) if n == number and isinstance(item, Message) else item


def flipped(message: Message) -> Message:
    """The same with one bit of its last value another."""
    data = bytearray(message.data)
    data[-3] ^= 1
    return message._replace(data=bytes(data))


# --- verify -----------------------------------------------------------------


def test_a_log_is_reproduced(log: Path) -> None:
    """Each mechanism: tests/system/test_same_bytes.py."""
    result = invoke("verify", log.parent)
    assert result.exit_code == 0, result.output
    count = sum(1 for _ in LogReader(log))
    assert result.stdout == f"reproduced bit for bit ({count} messages), up to t = 2.5 s\n"


@pytest.mark.slow
def test_everything_that_happened_to_a_live_run(tmp_path: Path) -> None:
    """Injected, healed, killed from outside, and ended with Ctrl-C: a distributed run comes again as far as it went."""
    with LiveRun(tmp_path / "runs", "rough-sea", "--duration", "600 s", "--speed", "4") as run:
        run.until_running(1.0)
        assert op(run.out, "inject", "link", "1<->2", "delay 300ms loss 20%", "--for", "1s").exit_code == 0
        assert op(run.out, "inject", "gust", "velocity=0.3 0 0 m/s", "over=20 s").exit_code == 0
        run.role("agent 3").kill()
        died_s = run.logged_s()
        assert op(run.out, "inject", "partition", "halves").exit_code == 0
        wait_for(lambda: run.logged_s() > died_s + 3.0, 60.0, "three more seconds")
        assert op(run.out, "heal").exit_code == 0
        died_s = run.logged_s()
        wait_for(lambda: run.logged_s() > died_s + 2.0, 60.0, "two more seconds")
        run.send(signal.SIGINT, group=True)
        assert run.status() == 130
        events = [r for r in LogReader(run.log) if r.topic == "faults"]
        assert len(events) >= 6
        result = invoke("verify", run.directory)
        assert result.exit_code == 0, result.output
        assert result.stdout.endswith(f"up to t = {run.logged_s():g} s of 600 s, where the run was ended\n")


@pytest.mark.parametrize("number", [signal.SIGINT, *slow(signal.SIGTERM)])
def test_an_interrupt_in_the_middle_of_a_message(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It waits for the end of what is written just then: the log is whole, up to a whole tick."""
    from fleet.mcap.writer import McapWriter

    add, messages = McapWriter.message, count()

    def interrupted(self: McapWriter, *message: Any) -> None:
        if next(messages) == 600:
            signal.raise_signal(number)
        add(self, *message)

    monkeypatch.setattr(McapWriter, "message", interrupted)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        result = recorded(tmp_path, "paper", "checks={}")
    finally:
        signal.signal(signal.SIGTERM, before)
    assert result.status is Status.INTERRUPTED and next(messages) > 600
    found = verify(result.directory)
    said = verification_lines(found)
    assert found.reproduced and said[0].endswith("where the run was ended"), said


@pytest.mark.parametrize("then", ["die", "abort"])
def test_a_run_with_a_controller_that_failed(then: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it left before is reproduced; what it would do next is not asked for, whether the run went on or not."""
    monkeypatch.setitem(TRACKING, "neurodynamic", TRACKING["neurodynamic"])  # restored after the sabotage
    exec(dedent(NAN_IN_THE_CORE), {})
    result = recorded(tmp_path, "paper", "duration=2 s", "checks={}", f"on_controller_error={then}")
    found = verify(result.directory)
    assert found.reproduced, verification_lines(found)
    assert found.until_s == (pytest.approx(0.5, abs=0.1) if result.status is Status.BROKEN else 2.0)


def test_a_cut_log_is_verified_as_far_as_it_goes(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    count = sum(1 for _ in LogReader(cut))
    result = invoke("verify", cut)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"reproduced bit for bit ({count} messages), up to t = ")
    assert "s of 2.5 s, as far as the file goes: the file is cut" in result.stdout


def test_one_bit_is_found(log: Path, tmp_path: Path) -> None:
    """Topic, time, tick, and the one field that differs on both sides, with its unit."""
    number = next(n for n, r in enumerate(LogReader(log)) if r.topic == "uuv/3/nav" and r.log_ns == 1_500_000_000)
    result = invoke("verify", altered(log, tmp_path / "a", at(number, flipped)))
    assert result.exit_code == 1
    first, head, names, field, rest, where = result.stdout.splitlines()
    assert first == f"NOT reproduced: {number} messages are the same, then"
    assert head == f"message {number}: uuv/3/nav, tick 150, t = 1.5 s, sent 1500000000 ns, seq 150"
    assert names.split() == ["field", "recorded", "re-run", "|a", "-", "b|", "unit"]
    assert field.startswith("  r ") and field.endswith("  rad/s")
    assert field.split()[1] != field.split()[2]
    assert rest == "  (9 other fields the same)"
    assert where.startswith("machine: recorded on a machine that no result")


def test_a_message_less_or_more(log: Path, tmp_path: Path) -> None:
    """In the middle, and behind a last message of the end tick: there both sides must have nothing more."""
    count = sum(1 for _ in LogReader(log))
    for number in (100, count - 1):
        found = verify(altered(log, tmp_path / f"less{number}", at(number, lambda message: None)))
        assert found.difference is not None
        assert (found.messages, found.difference.number) == (number, number)
    assert found.difference.a is None
    assert "recorded: the log ends here" in "\n".join(verification_lines(found))
    twice = altered(log, tmp_path / "more", lambda n, item: item)
    last = list(LogReader(log))[-1]

    def doubled(n: int, item: Part) -> Part:
        return item._replace(sequence=last.sequence + 1) if isinstance(item, Message) and n == count - 1 else item

    found = verify(altered(twice, tmp_path / "other", doubled))
    assert found.difference is not None
    text = "\n".join(verification_lines(found))
    assert "  recorded: " in text and "  re-run: " in text


def test_metadata_that_contradict_the_scenario(log: Path, tmp_path: Path) -> None:
    def change(n: int, item: Part) -> Part:
        return replace(item, metadata=item.metadata | {"seed": "7"}) if isinstance(item, Metadata) else item

    result = invoke("verify", altered(log, tmp_path / "a", change))
    assert result.exit_code == 1
    assert "contradiction: metadata seed: 7, but its scenario says 1" in result.stdout


def test_another_seed_in_the_scenario(log: Path, tmp_path: Path) -> None:
    def change(n: int, item: Part) -> Part:
        if isinstance(item, Attachment):
            return replace(item, data=item.data.replace(b"seed: 1", b"seed: 2"))
        return item

    found = verify(altered(log, tmp_path / "a", change))
    assert found.difference is not None and found.contradictions


def test_other_versions_are_a_likely_reason(log: Path, tmp_path: Path) -> None:
    """Said only when something differs: by themselves they are no fault."""
    older = {"piqp": "0.5.0", "law my:Law": "sha256 abc"}

    def change(n: int, item: Part) -> Part:
        if isinstance(item, Metadata):
            return replace(item, metadata=item.metadata | older)
        return flipped(item) if isinstance(item, Message) and n == 50 else item

    same = verify(altered(log, tmp_path / "same", lambda n, item: item if n >= 0 else change(n, item)))
    assert same.reproduced and len(same.versions) == 2
    assert len(verification_lines(same)) == 1
    result = invoke("verify", altered(log, tmp_path / "a", change))
    assert result.exit_code == 1
    assert "likely why: piqp: recorded with 0.5.0, here is 0." in result.stdout
    assert "likely why: law my:Law: recorded with sha256 abc, here is unknown" in result.stdout


@pytest.mark.parametrize("known", [True, False])
def test_another_machine_is_named_when_bytes_differ(log: Path, tmp_path: Path, known: bool) -> None:
    folder = tmp_path / "a"
    path = altered(log, folder, lambda n, item: flipped(item) if isinstance(item, Message) and n == 50 else item)
    assert (found := verify(path)).machine.endswith(f"here is {machine()}")
    if known:
        write_result(Result(status=Status.PASS, wall=Wall(machine="arm64, glibc 2.36")), path.parent)
        found = verify(path)
        assert found.machine == f"recorded on arm64, glibc 2.36, here is {machine()}"
    assert f"machine: {found.machine}" in verification_lines(found)
    write_result(Result(status=Status.PASS, wall=Wall(machine=machine())), path.parent)
    assert verify(path).machine == ""


def test_a_recovered_log_with_a_gap(log: Path, tmp_path: Path) -> None:
    """What is gone is passed over, what is left is compared; a bit behind the gap is still found."""
    data = bytearray(log.read_bytes())
    place = data.index(b"\x04\x00\x00\x00zstd", data.index(b"\x04\x00\x00\x00zstd") + 10)
    data[place + 200] ^= 1
    (tmp_path / "damaged").write_bytes(data)
    assert recover(tmp_path / "damaged", tmp_path / "mended").lost
    found = verify(tmp_path / "mended")
    assert found.reproduced, verification_lines(found)
    total = sum(1 for _ in LogReader(log))
    assert found.skipped > 100 and found.messages + found.skipped == total
    assert verification_lines(found)[1] == f"{found.skipped} messages are missing in the file and were not compared"
    changed = altered(tmp_path / "mended", tmp_path / "changed", at(found.messages - 5, flipped))
    assert verify(changed).difference is not None


def test_scenarios_that_do_not_run_here(log: Path, tmp_path: Path) -> None:
    """A law that is not installed, a key of another version: status 2 and what is wrong."""

    def change(n: int, item: Part) -> Part:
        if isinstance(item, Attachment):
            return replace(item, data=item.data + b"\nno_such_key: 1\n")
        return item

    result = invoke("verify", altered(log, tmp_path / "a", change))
    assert (result.exit_code, result.stdout) == (2, "")
    assert "no_such_key" in result.stderr


def test_verification_tells_where_it_is(log: Path) -> None:
    heard: list[tuple[float, float]] = []
    verify(log, lambda at_s, end_s: heard.append((at_s, end_s)))
    assert heard[-1] == (2.5, 2.5)
    assert heard == sorted(heard) and len(heard) > 10


def test_verification_of_nothing_is_no_success() -> None:
    assert verification_lines(Verification(Path("x"), 0.0, 1.0)) == []


# --- diff -------------------------------------------------------------------


def test_the_same_log(log: Path, tmp_path: Path) -> None:
    count = sum(1 for _ in LogReader(log))
    result = invoke("diff", log, log.parent, "-q")
    assert (result.exit_code, result.stdout) == (0, f"the same bit for bit ({count} messages)\n")


def nudged(tmp_path: Path, metres: str) -> Path:
    return run(tmp_path, "paper", "duration=2.5 s", ROUGH, "log.every=10 ticks", f"initial.3.position=8.5 {metres} 0 m")


def test_deviation_and_tolerance(log: Path, tmp_path: Path) -> None:
    other = nudged(tmp_path, "-10.100000001")
    result = invoke("diff", log, other, "-q", "--all")
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert lines[0].startswith("they part at message 2: uuv/3/pose, tick 0")
    table = [line.split() for line in lines[lines.index(next(x for x in lines if x.startswith("signal "))) + 1 :]]
    pose = next(row for row in table if row[0] == "uuv/3/pose.pose.position.y")
    assert pose[1:3] == ["1e-09", "m"]
    assert any("link/*.payload in " in line for line in lines)
    assert lines[-1] == "besides, not the same: attachment scenario.yaml"
    worst = float(table[0][1])
    near = invoke("diff", log, other, "-q", "--tolerance", worst * 1.01)
    assert near.exit_code == 0 and near.stdout.splitlines()[-1].startswith("within the tolerance of ")
    far = invoke("diff", log, other, "-q", "--tolerance", worst / 2)
    assert far.exit_code == 1 and far.stdout.splitlines()[-1].startswith("NOT within the tolerance of ")


def test_a_packet_that_is_later_is_the_same_packet(tmp_path: Path) -> None:
    """Paired by its number, so that its delay is a deviation, and not one packet less here and one more there."""
    logs = [run(tmp_path, "paper", "duration=2 s", f"network.links={{'*': 'delay {ms}ms'}}") for ms in (100, 130)]
    found = compare(*map(LogReader, logs))
    assert not found.only_a and not found.only_b
    assert found.signals["link/1-2.delay"].value == pytest.approx(0.03)
    assert found.signals["link/1-2.log_time"].value == pytest.approx(0.03)


def test_a_run_and_its_continuation_are_compared_from_where_it_begins(tmp_path: Path) -> None:
    whole = run(tmp_path, "paper", "duration=2 s")
    for changes, status, words in (
        ([], 0, "the same bit for bit ("),
        (["controller=bsmc"], 1, "they part at message "),
    ):
        scenario, start = continuation(whole, 1_000_000_000, changes)
        rest = execute(scenario, Options(tmp_path, in_process=True, quiet=True), wiring=Wiring(start=start)).directory
        for logs, name in (((whole, rest), "b"), ((rest, whole), "a")):
            result = invoke("diff", *logs, "-q")
            lines = result.stdout.splitlines()
            assert result.exit_code == status, result.stdout
            assert lines[0].startswith(f"compared from t = 1 s on, where {name} begins: it goes on from {whole}")
            assert lines[1].startswith(words)
            if changes:
                assert ", tick 100, t = 1 s" in lines[1]
            assert not any("start.msgpack" in line or "metadata" in line or "only in" in line for line in lines)
        assert invoke("diff", rest, rest, "-q").stdout.startswith("the same bit for bit (")


def test_missing_messages_and_topics_are_counted(log: Path, tmp_path: Path) -> None:
    fewer = run(tmp_path, "paper", "vehicles=3", "duration=2.5 s", ROUGH, "log.every=20 ticks")
    found = compare(LogReader(log), LogReader(fewer))
    assert found.only_a["uuv/4/pose"] == 26
    assert found.only_a["uuv/1/pose"] == 12
    assert found.only_b.keys() <= {"scene"}  # every 0.5 s there, but every 0.6 s where frames are 0.2 s apart
    assert not found.within(inf)
    result = invoke("diff", log, fewer, "-q", "--tolerance", "1e9")
    assert result.exit_code == 1
    assert "only in a: " in result.stdout and "of uuv/*/pose" in result.stdout


def test_memory_is_bounded(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a log that stops early the other's messages cannot all wait for their halves."""
    monkeypatch.setattr(fleet.logs.deviation, "MOST_WAITING", 20)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    found = compare(LogReader(log), LogReader(cut))
    count, left = (sum(1 for _ in LogReader(path)) for path in (log, cut))
    assert (found.same, sum(found.only_a.values())) == (left, count - left)
    result = invoke("diff", log, cut, "-q")
    assert result.exit_code == 1
    assert "b is NOT WHOLE: the file is cut" in result.stdout
    assert "  b: the log ends here (the file is cut" in result.stdout


@pytest.mark.parametrize(("a", "b", "apart"), [(nan, nan, 0.0), (nan, 1.0, inf), (inf, inf, 0.0), (1.5, 1.0, 0.5)])
def test_distance_of_what_is_no_number(a: float, b: float, apart: float) -> None:
    assert fleet.logs.deviation._distance(a, b) == apart


def test_units_of_fields(log: Path) -> None:
    """Of a nested field, of an array with one unit each, of none."""
    reader = LogReader(log)
    decode = Decoder(reader)
    units: dict[str, dict[str, str]] = {}
    for record in reader:
        units.setdefault(record.topic, {value.path: value.unit for value in decode(record)})
    assert units["uuv/1/pose"]["pose.position.y"] == "m"
    assert units["uuv/1/command"]["tau_0"] == "N" and units["uuv/1/command"]["applied_2"] == "N m"
    assert units["uuv/1/error"]["e_2"] == "m"
    assert units["link/1-2"]["delay"] == "s" and units["link/1-2"]["payload"] == ""
