"""Logs that are bombs and logs that are huge: bounded memory, the same results, a word on how far, a clean Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
from bisect import bisect_left
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from foreign_log import foreign
from google.protobuf import struct_pb2
from huge_log import again, blobs, bomb, chunk, record, text, write
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone, log_of
from mcap.opcode import Opcode
from tool import invoke
from waiting import wait_for

import fleet
from fleet.logs import columns, decoder, deviation, export, open_log, topic
from fleet.logs.info import info_text, read_info
from fleet.logs.open_log import Opening, Part
from fleet.mcap import reader, records, seekable_log
from fleet.mcap.reader import LogReader, LogReadError
from fleet.terminal import progress
from netem.limits import LOG_FAULTS, LOG_MESSAGE, LOG_RECORD, LOG_REST
from netem.whole_file import whole_file

MIB = 1 << 20
LIMIT_S = 60.0


@pytest.fixture(scope="module")
def run(made: Alone) -> Path:
    return log_of(made("paper", "duration=3 s", "checks={}", "faults=[{at: 1 s, for: 500 ms, id: crash, kill: 2}]"))


@pytest.fixture(scope="module")
def long(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole log of some hundred thousand messages."""
    return again(tmp_path_factory.mktemp("long") / "long.mcap", run, 6, 8 * MIB, same=True)


# --- bombs -------------------------------------------------------------------


def child(*arguments: object) -> tuple[int, str, float]:
    """Exit status, what was said, and peak memory [MB] of a command that is a process of its own."""
    code = (
        "import re, sys\n"
        "from fleet.__main__ import main\n"
        "try:\n    main()\n"
        "finally:\n"
        # Not ru_maxrss, which begins with that of the process that started this one.
        "    peak = re.search(r'VmHWM:\\s+(\\d+) kB', open('/proc/self/status').read())[1]\n"
        "    print('PEAK', int(peak) / 1000, file=sys.stderr)\n"
    )
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    said, _, peak = done.stderr.rpartition("PEAK ")
    return done.returncode, said, float(peak)


@pytest.mark.parametrize("says", [512 * MIB, pytest.param(60 * MIB, marks=pytest.mark.slow)])
def test_a_bomb_takes_no_memory(tmp_path: Path, says: int) -> None:
    """Half a gigabyte in a few kB, told honestly or not: refused, with the place, in a fraction of that."""
    path = bomb(tmp_path / "bomb.mcap", 512 * MIB, says=says)
    assert path.stat().st_size < 100_000
    status, said, peak = child("replay", path, "--speed", "0")
    assert (status, "at byte 34" in said) == (2, True)
    assert ("unpacks to 536870912 bytes, more than the 67108864 that are read" in said) == (says > 64 * MIB)
    assert peak < 250.0, said


@pytest.mark.parametrize("command", [
    ["info"], ["export", "--scenario"], ["verify"], ["recover"], ["replay"], ["plot"], ["report"],
    ["export", "--csv", "t"],
])  # fmt: skip
def test_one_scanner_for_all(tmp_path: Path, command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path / "a.mcap", iter([(chunk(b"", 0, 1, size=64 * MIB + 1), 1, 0, 1)]))
    result = invoke(*command, path)
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code in (0, 1, 2, 3)
    if "--scenario" not in command:
        assert "unpacks to 67108865 bytes" in result.output or command == ["verify"]
    monkeypatch.undo()


def test_what_lz4_unpacks_to_is_bounded_too() -> None:
    packed = lz4.frame.compress(bytes(32 * MIB), store_size=False)
    body = chunk(packed, 0, 1, size=1000, compression="lz4")[9:]
    with pytest.raises(ValueError, match=r"^$"):
        records.content(body)
    whole = lz4.frame.compress(bytes(1000))
    assert records.content(chunk(whole, 0, 1, size=1000, compression="lz4")[9:]) == bytes(1000)
    with pytest.raises(ValueError, match="compression 'xz', which is not known"):
        records.content(chunk(whole, 0, 1, size=1000, compression="xz")[9:])


def test_what_a_log_declares_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the records is small enough; the same one again and again takes no more."""
    monkeypatch.setattr(reader, "LOG_REST", LOG_REST._replace(bytes=10_000))
    many = b"".join(record(Opcode.METADATA, text(f"m{n}") + text(text("k") + text("v" * 500))) for n in range(20))
    with pytest.raises(LogReadError, match=r"declares \d+ bytes of attachments, metadata, schemas and channels, more"):
        list(LogReader(write(tmp_path / "a.mcap", iter([]), many)))
    same = record(Opcode.METADATA, text("m") + text(text("k") + text("v" * 500))) * 100
    found = LogReader(write(tmp_path / "b.mcap", iter([]), same))
    assert list(found) == []
    assert found.metadata["m"]["k"] == "v" * 500


def test_a_message_of_too_many_values_is_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = foreign(tmp_path / "x.mcap")
    monkeypatch.setattr(decoder, "LOG_MESSAGE", LOG_MESSAGE._replace(items=1))
    log = LogReader(path)
    decode = decoder.Decoder(log)
    found = {r.topic: [value.path for value in decode(r)] for r in log}
    assert found["odd"] == ["bytes"]  # the last one has three
    monkeypatch.setattr(decoder, "LOG_MESSAGE", LOG_MESSAGE._replace(bytes=3))
    assert decode.message(reader.Record("odd", 0, 0, 0, struct_pb2.Struct().SerializeToString() + bytes(10))) is None


# --- the tape of a replay ----------------------------------------------------


def test_a_tape_holds_little_at_a_time(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Any message, and any time, by looking at a stretch of the file."""
    monkeypatch.setattr(seekable_log, "_HELD", 0)
    whole = list(LogReader(run))
    found = seekable_log.SeekableLog(run)
    chosen = {n for n, c in found.channels.items() if c.topic.startswith("link/") or c.topic == "uuv/1/state"}
    track = seekable_log.Track(found, chosen)
    expected = [(n, r) for n, r in enumerate(whole) if r.topic.startswith("link/") or r.topic == "uuv/1/state"]
    assert len(track) == len(expected)
    for some in (range(len(track)), range(3, 300)):
        entries = [(n, e.channel.topic, e.log_ns, e.data) for n, e in track.entries(some)]
        assert entries == [(n, r.topic, r.log_ns, r.data) for n, r in expected[some.start : some.stop]]
    times = list(track)
    assert times == sorted(times)
    for ns in [-1, 0, 1, *times[::400], times[-1] + 1, 1 << 64]:
        assert track.before(ns) == bisect_left(times, ns)
    assert len(found._open) <= 2


# --- arrays ------------------------------------------------------------------


def equal(a: Any, b: Any) -> bool:
    def same(x: Any, y: Any) -> bool:
        return np.array_equal(x, y) if x.dtype == object else np.array_equal(x, y, equal_nan=True)

    return len(a) == len(b) and a.fields == b.fields and all(same(a[name], b[name]) for name in a.fields)


def test_a_log_that_cannot_be_held_is_read_by_topic(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fleet.open_log(run)
    monkeypatch.setattr(topic, "STEP", 10_000)
    log = Opening(run, most_held=300_000).read()
    assert (log.topics, log.messages, log.end, log.vehicles) == (
        whole.topics,
        whole.messages,
        whole.end,
        whole.vehicles,
    )
    assert sum(each.cost for each in log._topics.values()) == 0
    for name in ("uuv/1/state", "uuv/2/error", "link/1-2", "faults", "uuv/3/pose"):
        assert equal(log[name], whole[name]), name
        assert np.array_equal(log[name].t, whole[name].t)
        assert np.array_equal(log[name].publish_ns, whole[name].publish_ns)
    assert sum(each.cost for each in log._topics.values()) < 400_000
    assert log.faults == whole.faults


def test_a_topic_that_cannot_be_held_says_what_to_do(run: Path) -> None:
    log = Opening(run, most_held=20_000).read()
    with pytest.raises(LogReadError, match=r"uuv/1/state holds \d+ messages of .* MB, more than .*every=\d+") as told:
        _ = log["uuv/1/state"].x
    every = int(str(told.value).split("every=")[1].split(")")[0])
    part = Opening(run, ["uuv/1/state"], part=Part(every=every), most_held=20_000).read()
    assert len(part["uuv/1/state"].x) > 5


def test_a_part_of_a_log(run: Path) -> None:
    whole, part = fleet.open_log(run), fleet.open_log(run, start=1.0, end=2.0, every=7)
    for name in ("uuv/1/state", "link/1-2"):
        full = whole[name]
        kept = np.flatnonzero((full.t >= 1.0) & (full.t <= 2.0))[::7]
        assert np.array_equal(part[name].t, full.t[kept])
        assert all(np.array_equal(part[name][field], full[field][kept]) for field in full.fields)
    for wrong in ({"every": 0}, {"start": 2.0, "end": 1.0}):
        with pytest.raises(LogReadError, match=r"every=0|start=2"):
            fleet.open_log(run, **wrong)


@given(st.lists(st.tuples(st.integers(0, 5), st.floats(width=16)), min_size=1, max_size=60))
def test_extremes_are_those_of_each_bucket(rows: list[tuple[int, float]]) -> None:
    buckets = np.array([bucket for bucket, _ in rows])
    values = np.array([value for _, value in rows])
    kept = columns.extremes(buckets, [values])
    assert np.array_equal(kept, np.unique(kept))
    for bucket in set(buckets.tolist()):
        here = np.flatnonzero(buckets == bucket)
        some = [k for k in kept if buckets[k] == bucket]
        assert (some[0], some[-1], len(some) <= 4) == (here[0], here[-1], True)
        if not np.isnan(values[here]).all():
            assert np.nanmin(values[some]) == np.nanmin(values[here])
            assert np.nanmax(values[some]) == np.nanmax(values[here])


def test_pictures_of_a_log_that_cannot_be_held(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every extreme is there, packets are counted, and what is drawn takes little."""
    from fleet.addons.pictures.gallery import draw
    from fleet.addons.pictures.runs import View, load

    (whole,) = load([run])
    monkeypatch.setattr(open_log, "BUCKETS", 20)
    (thin,) = load([run], most_held=600_000)
    state, full = thin.log["uuv/1/state"], whole.log["uuv/1/state"]
    assert 20 < len(state.x) < len(full.x) / 1.5
    for name in full.fields:
        assert (state[name].min(), state[name].max()) == (full[name].min(), full[name].max())
    assert (state.t[0], state.t[-1]) == (full.t[0], full.t[-1])
    assert "payload" not in thin.log["link/1-2"] and len(thin.log["link/1-2"]) == len(whole.log["link/1-2"])
    assert thin.log.faults == whole.log.faults
    drawn = dict((name, figure) for name, _, figure in draw(["track", "error", "links", "ages"], [thin], View()))  # noqa: C402
    assert not [figure for figure in drawn.values() if isinstance(figure, str)]
    (line,) = [line for line in drawn["error"].axes[0].get_lines() if line.get_gid() == "paper-vehicle-1"]
    assert not np.isnan(np.asarray(line.get_ydata(), float)).any()  # thinned is not silent


def test_links_that_cannot_be_held_are_no_picture(run: Path) -> None:
    from fleet.addons.pictures.gallery import draw
    from fleet.addons.pictures.runs import View, load

    (thin,) = load([run], most_held=2000)
    found = {name: figure for name, _, figure in draw(["links", "ages"], [thin], View())}
    assert found
    for figure in found.values():
        assert "messages of 0 MB, more than is held at once" in str(figure)


# --- tables ------------------------------------------------------------------


def test_tables_written_in_parts_are_the_same(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those of vectors that are not always as long, which only a later part shows."""
    for log, name in ((fleet.open_log(run), "run"), (fleet.open_log(foreign(tmp_path / "x"), ["odd", "words"]), "odd")):
        once = export.export(log, tmp_path / name, "csv")
        with monkeypatch.context() as patch:
            patch.setattr(export, "_HELD", 0)
            patch.setattr(records, "LOG_RECORD", LOG_RECORD._replace(items=1 if name == "odd" else 500))
            parts = export.export(log, tmp_path / f"{name}-parts", "csv")
        for a, b in zip(once, parts, strict=True):
            assert a.read_text() == b.read_text(), a
    assert sorted(path.suffix for path in (tmp_path / "odd").iterdir()) == [".csv", ".csv", ".json"]


def test_large_cells_are_written_as_small_ones(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = fleet.open_log(run, ["link/1-2", "faults"])
    once = export.export(log, tmp_path / "a", "csv")
    monkeypatch.setattr(export, "_LARGE", 7)
    assert [path.read_text() for path in export.export(log, tmp_path / "b", "csv")] == [p.read_text() for p in once]


def test_nothing_is_left_of_a_file_that_could_not_be_written(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("before")

    def fail() -> None:
        with whole_file(tmp_path / "a") as part:
            part.write_text("half")
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fail()
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "before")]
    with whole_file(tmp_path / "a") as part:
        part.write_text("after")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "after")]


# --- two logs ----------------------------------------------------------------


@pytest.mark.slow
def test_few_bytes_wait_for_their_other_half(long: Path, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two logs that have nothing to do with one another: all that is held is bounded, and all of it is counted."""
    most = 0
    monkeypatch.setattr(deviation, "MOST_WAITING_BYTES", 5000)
    add = deviation._Waiting.add

    def watched(self: Any, *arguments: Any) -> Any:
        nonlocal most
        yield from add(self, *arguments)
        most = max(most, self._bytes)

    monkeypatch.setattr(deviation._Waiting, "add", watched)
    found = deviation.compare(LogReader(run), LogReader(long))
    count = sum(1 for _ in LogReader(run))
    assert found.same + found.paired + found.only_a.total() == count
    assert 0 < most <= 5000


def test_equal_logs_are_compared_in_blocks(long: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However their messages lie in chunks."""
    monkeypatch.setattr(deviation, "_meet", None)
    found = deviation.compare(LogReader(long), LogReader(long))
    assert (found.first, found.same) == (None, sum(len(block) for block in LogReader(long).blocks()))


# --- progress and Ctrl-C -----------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("command", ["info", "export", "diff", "recover", "plot", "report"])
def test_progress_is_told_on_stderr(command: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", 0.0)
    out = {
        "recover": ["-o", tmp_path / "a"], "export": ["--csv", tmp_path / "t", "--topics", "faults"],
        "plot": ["-o", tmp_path, "--what", "error"], "report": ["-o", tmp_path / "r.html"], "diff": [run],
    }  # fmt: skip
    result = invoke(command, run, *map(str, out.get(command, [])))
    assert result.exit_code == 0, result.output
    doing = {"diff": "comparing", "recover": "recovering"}.get(command, "reading")
    assert any(line.startswith(doing) and line.endswith(" %") for line in result.stderr.splitlines())
    assert " %" not in result.stdout


def test_nothing_is_said_of_what_is_short(run: Path) -> None:
    result = invoke("info", run)
    assert (result.exit_code, result.stderr) == (0, "")


def test_faults_beyond_the_limit_are_counted(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were left out without a word."""
    whole = read_info(run)
    monkeypatch.setattr("fleet.logs.info.LOG_FAULTS", LOG_FAULTS._replace(items=2))
    some = read_info(run)
    assert (whole.unread, some.unread) == (0, whole.topics["faults"][1] - 2)
    assert f"LEFT OUT: {some.unread} messages about faults" in info_text(some)
    assert "LEFT OUT" not in info_text(whole)


@pytest.mark.parametrize("command", [["export", "--csv"], ["recover", "-o"]])
def test_ctrl_c_leaves_nothing(long: Path, tmp_path: Path, command: list[str]) -> None:
    out = tmp_path / "out"
    place = out if command[0] == "export" else tmp_path
    started = subprocess.Popen(
        [sys.executable, "-m", "fleet", command[0], long, command[1], out], stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: list(place.glob(".*")), LIMIT_S, "the first part of a file")
    started.send_signal(signal.SIGINT)
    _, said = started.communicate(timeout=LIMIT_S)
    assert started.returncode == 130
    assert "Traceback" not in said
    assert list(place.glob(".*")) == [] and (command[0] != "export" or list(out.iterdir()) == [])


def test_a_topic_of_huge_messages(tmp_path: Path) -> None:
    """Each of them fits; together they do not, and are never held together."""
    path = blobs(tmp_path / "blobs.mcap", 4, 2 * MIB)
    assert [len(data) for data in fleet.open_log(path)["camera"].data] == [2 * MIB - 4096] * 4
    with pytest.raises(LogReadError, match="camera holds 4 messages of 8 MB"):
        _ = Opening(path, most_held=4 * MIB).read()["camera"].data
