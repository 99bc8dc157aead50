"""Runs that are published while they go on."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
from collections import Counter
from contextlib import suppress
from pathlib import Path
from threading import Timer

import pytest
from live import LiveRun
from marks import slow
from traffic import LIMIT_S, Command, Ear, schemas_of, session
from traffic import log as log
from traffic import records as records
from waiting import wait_for

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.logs.schemas import FAULT, flat_schema
from fleet.mcap.reader import Record
from fleet.replay.capture import zenoh_encoding
from fleet.replay.live_journal import Missing
from fleet.replay.publisher import BATCH_BYTES, LivePublisher
from fleet.replay.topics import unpack
from fleet.scenario.loading import load_scenario
from netem.errors import BusError
from netem.wire.credentials import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus


def missing_to(ear: Ear, end: Ear, prefix: str) -> Missing:
    """What somebody did not hear of a journal that is over."""
    missing = Missing()
    for sample, place in zip(list(ear.samples), list(ear.places), strict=False):
        missing.came(sample.key.removeprefix(f"{prefix}/log/"), place)
    missing.end(end.samples[0].payload)
    return missing


@pytest.mark.parametrize("where", ["distributed", *slow("in-process")])
def test_live_publishing_equals_the_log(where: str, log: Path, records: list[Record], tmp_path: Path) -> None:
    """From the first sample heard on, every message of the log comes once, in order, with what a replay would say, or
    is counted as missing; the log is the same as without; and the way in is private, read-only and gone afterwards."""
    arguments = ["paper", "--duration", "2 s", "--set", "checks={}", "--speed", "4"]
    arguments += ["--publish", "--wait-for-subscribers"]
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
            with pytest.raises(BusError) as caught:
                OpenBus.connect(values["endpoint"], Credentials("observer", "guess"), timeout_ms=300)
            assert "guess" not in str(caught.value)
            end, overheard = Ear(bus, f"{prefix}/log-end"), Ear(other, "**")
            ear = Ear(bus, f"{prefix}/log/**")  # for which the run waits
            other._session.put(f"{prefix}/log/uuv/1/state", b"forged")
            end.until(1)
            with suppress(AssertionError):  # what was lost does not come
                wait_for(lambda: not missing_to(ear, end, prefix).to_come, LIMIT_S / 6)
            missing = missing_to(ear, end, prefix)
        assert run.status() == 0, run.printed
        run.until_nobody_is_left()
        assert run.log.read_bytes() == log.read_bytes()
        assert not path.exists()
        told = json.loads((run.directory / "result.json").read_text())["published"]
    heard = list(ear.samples)  # and nothing that an observer put
    assert told["messages"] >= len(heard)
    stamps = [unpack(s.attachment or b"") for s in heard]
    numbers = [stamp.number for stamp in stamps]
    assert numbers == sorted(set(numbers))
    counted = Counter(record.topic for record in records[numbers[0] :])
    for topic, count in Counter(records[number].topic for number in numbers).items():
        assert count + missing.of(topic) == counted[topic], topic  # none is missing where a machine is not too busy
    schemas = schemas_of(log)
    for sample, stamp in zip(heard, stamps, strict=True):
        record = records[stamp.number]
        assert stamp[:3] == (record.log_ns, record.publish_ns, record.sequence)
        assert sample.payload == record.data and not sample.delete
        assert sample.key == f"{prefix}/log/{record.topic}"
        assert sample.encoding == zenoh_encoding("protobuf", schemas[record.topic])
    # The wildcard was refused, because it names more than the journal; what a session says to itself never leaves it.
    assert {s.payload for s in overheard.samples} <= {b"forged"}


def test_what_comes_last_waits_for_room(tmp_path: Path) -> None:
    """At the end of a run the publisher's process is waited for, so its pipe may be full by then."""
    publisher = LivePublisher("0123abcd", tmp_path / "observe.json", "")
    publisher.channel(0, "a", flat_schema("Fault", FAULT))
    sink = subprocess.Popen(["sh", "-c", "exec cat > /dev/null"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert sink.stdin is not None
    os.set_blocking(sink.stdin.fileno(), False)
    publisher._process = sink
    sink.send_signal(signal.SIGSTOP)
    while not publisher._rest:
        publisher.message(0, 0, 0, 0, bytes(BATCH_BYTES))
    publisher.message(0, 0, 0, 0, b"the last one")
    going_on = Timer(0.2, sink.send_signal, [signal.SIGCONT])
    going_on.start()
    publisher.close()
    going_on.join()
    assert publisher.dropped == 0


@pytest.mark.slow
def test_a_subscriber_that_sleeps_does_not_hold_the_run(tmp_path: Path) -> None:
    """It is suspended from the beginning on; the run goes on, ends well, and its log is the same."""
    arguments = ["paper", "--duration", "10 s", "--set", "checks={}"]
    with LiveRun(tmp_path / "runs", *arguments, "--speed", "5", "--publish", "--wait-for-subscribers") as run:
        path = tmp_path / "runs" / "latest" / "observe.json"
        wait_for(lambda: path.exists() and path.stat().st_size, LIMIT_S, "observe.json")
        directory = path.parent.resolve()
        with Command("record", "--run", directory, "-o", tmp_path / "x.mcap") as recorder:
            recorder.until("recording")
            recorder.send(signal.SIGSTOP)
            assert run.status() == 0, run.printed
        told = json.loads((directory / "result.json").read_text())["published"]
        published = run.log
        assert told["dropped"] == 0  # the publisher's process never waits for a subscriber
        plain = execute(load_scenario("paper", ["duration=10 s", "checks={}"]), Options(tmp_path, True, quiet=True))
        assert (plain.directory / "run.mcap").read_bytes() == published.read_bytes()


@pytest.mark.slow
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
