"""A log as arrays: the same numbers as mcap's own protobuf decoder gives, of whole logs, cut ones and strange ones."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_log import foreign
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from repository import ROOT
from tool import invoke

import fleet
from fleet.errors import ScenarioError
from fleet.logs.export import export, file_names
from fleet.logs.open_log import Opening
from fleet.logs.topic import LogKeyError
from fleet.mcap.digest import Digest
from fleet.mcap.reader import LogReader, LogReadError, digest
from fleet.scenario.loading import load_scenario
from tests.support.intervals import interval


@pytest.fixture(scope="module")
def run(made: Alone) -> Path:
    """Lost and corrupted packets, a dead agent, and vehicles whose laws report different things."""
    faults = "faults=[{at: 1 s, for: 500 ms, id: crash, kill: 2}, {at: 1.2 s, down: '3->4'}]"
    links = "network.links={'*': delay 30ms loss 20% corrupt 20%}"
    return made("paper", "checks={}", "duration=2 s", faults, links, "per_vehicle.3.controller=bsmc").directory


def expected(log: Path) -> dict[str, list[tuple[int, Any]]]:
    """(log time, decoded message) by topic, read by mcap and decoded by mcap-protobuf-support."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with log.open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def test_every_field_of_every_topic_is_what_protobuf_says(run: Path) -> None:
    log = fleet.open_log(run)
    assert log.missing == ""
    messages = expected(run / "run.mcap")
    assert {topic for topic in log if len(log[topic])} == messages.keys()
    for name, taken in messages.items():
        topic = log[name]
        assert topic.t == pytest.approx([at / 1e9 for at, _ in taken])
        if name.endswith("/pose"):
            poses = [message.pose for _, message in taken]
            assert (topic["pose.position"] == [[p.position.x, p.position.y, p.position.z] for p in poses]).all()
            assert topic["pose.orientation"].shape == (len(taken), 4)
            assert (topic["timestamp"] == topic.t).all()
            continue
        assert list(topic.fields) == [field.name for field in taken[0][1].DESCRIPTOR.fields]
        for field in topic.fields:
            values = [getattr(message, field) for _, message in taken]
            array = topic[field]
            if topic.nested:  # messages of two pools are never equal
                assert [list(map(str, v)) for v in array] == [list(map(str, v)) for v in values]
                continue
            assert array.tolist() == [list(v) if hasattr(v, "append") else v for v in values]
            assert array.shape[0] == len(taken)


def test_units_and_meanings_come_from_the_log(run: Path) -> None:
    log = fleet.open_log(run)
    state = log["uuv/1/state"]
    assert (state.units["x"], state.meanings["x"], state.units["r"]) == ("m", "north", "rad/s")
    assert state.x.shape == (201,)
    assert state.x.dtype == np.float64
    assert log["uuv/1/command"].tau.shape == (200, 3)
    assert "psi [rad]" in repr(state)
    assert {"x", "t", "units"} <= set(dir(state)) and not {"drop", "fetch", "compact"} & set(dir(state))
    assert log["uuv/3/control"].schema != log["uuv/1/control"].schema


def test_text_and_bytes_are_objects(run: Path) -> None:
    link = fleet.open_log(run)["link/1-2"]
    assert link.fate.dtype == object
    assert link.payload.dtype == object
    assert isinstance(link.payload[0], bytes)
    assert link.corrupted.dtype == np.bool_
    assert link.seq.dtype == np.int64
    lost = link.fate != "delivered"  # as a user would ask
    assert 0 < lost.sum() < len(link)
    assert (link.publish_ns / 1e9 == pytest.approx(link.sent)) and (link.t[~lost] == pytest.approx(link.due[~lost]))


def test_what_the_log_says_of_itself(run: Path) -> None:
    log = fleet.open_log(str(run / "run.mcap"))
    assert log.scenario == load_scenario(run / "scenario.yaml")
    assert log.run["seed"] == "1"
    assert log.vehicles == [1, 2, 3, 4]
    assert log.links == [(1, 2), (2, 1), (2, 3), (3, 2), (3, 4), (4, 3)]
    assert log.end == 2.0
    crash, down = log.faults
    assert (crash, down) == (interval("crash", 1.0, 1.5, "kill 2"), interval("f2", 1.2, 2.0, "down 3->4"))
    assert [(t.id, t.end, t.what) for t in log.events] == [(f"tumbled-{i}", 2.0, f"tumbled {i}") for i in (2, 3)]
    assert len(log) == len(log.topics) == len(list(log))
    assert f"{log.messages} messages in 37 topics, 2 s" in repr(log)


@pytest.mark.parametrize("cut", [0, 20_000], ids=["whole", "cut"])
def test_the_digest_is_that_of_the_messages(run: Path, tmp_path: Path, cut: int) -> None:
    """Message by message, in blocks, and along with what is drawn."""
    log = tmp_path / "run.mcap"
    log.write_bytes((run / "run.mcap").read_bytes()[: -cut or None])
    total = Digest()
    for one in LogReader(log):
        total.add(one.topic.encode(), one.log_ns, one.publish_ns, one.sequence, one.data)
    drawn = Opening(log, ["uuv/1/*"], drawn={}).read()
    assert fleet.open_log(log).digest == digest(log) == drawn.digest == total.hexdigest()


def test_only_the_topics_that_are_asked_for(run: Path) -> None:
    told: list[float] = []
    log = fleet.open_log(run, topics=["uuv/*/state", "faults"], progress=told.append)
    assert log.topics == [f"uuv/{i}/state" for i in range(1, 5)] + ["faults"]
    assert fleet.open_log(run, topics="link/*").vehicles == []
    assert told
    assert all(fnmatchcase(topic, "uuv/*/state") or topic == "faults" for topic in log)


def test_what_is_not_there_is_named(run: Path) -> None:
    log = fleet.open_log(run)
    with pytest.raises(LogKeyError, match="has no topic 'uuv/1/stat'; did you mean"):
        log["uuv/1/stat"]
    with pytest.raises(KeyError):
        log["uuv/9/state"]
    with pytest.raises(AttributeError, match="has no field 'X'"):
        _ = log["uuv/1/state"].X
    assert "uuv/9/state" not in log
    for wrong in (0, -1, slice(3), None, ("x", "y")):
        with pytest.raises(
            KeyError, match=r"fields have names, got .*; each is an array of its samples, as in topic\['x'\]"
        ):
            log["uuv/1/state"][wrong]  # type: ignore[index]
        with pytest.raises(KeyError, match="topics have names such as 'uuv/1/state', got "):
            log[wrong]  # type: ignore[index]
    assert not hasattr(log["uuv/1/state"], "_repr_html_")


def test_a_topic_goes_through_its_fields_as_a_dictionary_does(run: Path) -> None:
    """`for x in log["uuv/1/pose"]` ended in an error about `lower`."""
    log = fleet.open_log(run)
    for name in log:
        assert [*log[name]] == list(log[name].fields)
    state = log["uuv/1/state"]
    assert {field: len(state[field]) for field in state} == dict.fromkeys(state.fields, len(state))


def test_a_cut_log_gives_what_is_left(run: Path, tmp_path: Path) -> None:
    whole = run / "run.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    log, full = fleet.open_log(cut), fleet.open_log(whole)
    assert "cut" in log.missing
    assert 0.9 < log.end < 2.0
    assert log.scenario == full.scenario
    state = log["uuv/4/state"]
    assert (state.x == full["uuv/4/state"].x[: len(state)]).all()
    assert log.faults == [f._replace(end=log.end) for f in full.faults if f.begin <= log.end]
    assert "NOT WHOLE" in repr(log)


def test_thinned_log_and_topics_without_a_message(made: Alone, tmp_path: Path) -> None:
    log = fleet.open_log(
        made("ideal", "checks={}", "duration=1 s", "log={every: 10 ticks, command: 25 ticks}").directory
    )
    assert log["uuv/1/state"].t == pytest.approx(np.arange(11) / 10)
    assert log["uuv/1/command"].t == pytest.approx([0.0, 0.25, 0.5, 0.75])
    empty = log["faults"]
    assert (len(empty), empty.t.tolist(), list(empty.fields)) == (0, [], ["fault", "action", "what"])
    assert log.faults == []
    nothing = tmp_path / "start.mcap"
    with nothing.open("wb") as file:
        Writer(file).start()
    assert (len(fleet.open_log(nothing)), fleet.open_log(nothing).end) == (0, 0.0)


def test_logs_that_are_not_ours(tmp_path: Path) -> None:
    """Payloads that nobody explained stay bytes; protobuf decodes whatever its shape; there is no scenario."""
    log = fleet.open_log(foreign(tmp_path / "x.mcap"))
    assert log["words"].data.tolist() == [b'{"k": 0}', b'{"k": 1}', b'{"k": 2}']
    assert [list(values) for values in log["odd"].values] == [[], [1.0], [1.0, 1.0]]
    assert log["odd"].more.tolist() == [0.0, 1.0, 2.0]
    assert log["odd"].units == {"values": "", "more": ""}
    assert len(log["nested"].fields) == 1
    with pytest.raises(LogReadError, match="schema No cannot be used"):
        _ = log["broken"].fields
    with pytest.raises(LogReadError, match="holds no scenario"):
        _ = log.scenario
    assert (log.run, log.vehicles, log.links) == ({}, [], [])


def test_a_scenario_that_cannot_be_used_here(run: Path) -> None:
    log = fleet.open_log(run)
    log.scenario_text = "name: x\ncontroller: gone:Law\n"
    with pytest.raises(ScenarioError):
        _ = log.scenario


def test_importing_the_package_is_light() -> None:
    code = "import sys, fleet; print([m for m in ('numpy', 'google.protobuf', 'mcap', 'zenoh') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
    with pytest.raises(AttributeError, match="no attribute 'swim'"):
        _ = fleet.swim


def test_example_of_the_page(run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The worked example of docs/guide/logs.md, as it stands there, on a run of this test."""
    page = (ROOT / "docs" / "guide" / "logs.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) >= 4
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "latest").symlink_to(run)
    export(fleet.open_log(run, ["uuv/1/command"]), tmp_path / "tables", "parquet")
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    assert isinstance(names["log"], fleet.Log)
    assert (tmp_path / "errors.png").exists()


def test_a_log_as_a_table_and_the_call_that_makes_a_table_of_a_topic(run: Path) -> None:
    log = fleet.open_log(run, ["uuv/1/state"])
    assert "<td>uuv/1/state</td><td>uuv_fleet.State</td><td>201</td>" in log._repr_html_()
    with pytest.raises(AttributeError, match=r"log.to_pandas\('uuv/1/state'\)"):
        log["uuv/1/state"].to_pandas()


ODD = st.text("/a-.\x1b\n*é A", max_size=6) | st.text(max_size=300)


@given(st.lists(ODD, unique=True))
def test_every_topic_has_a_file_of_its_own(topics: list[str]) -> None:
    """Also on a disk that does not tell upper from lower case; the name is no option, and is not hidden."""
    names = file_names(topics)
    assert list(names) == topics and len({name.casefold() for name in names.values()}) == len(topics)
    for name in names.values():
        assert name.isprintable() and "/" not in name and name[0] not in "-." and len(f"{name}.parquet".encode()) < 255
    assert file_names(["/scan", "uuv/1/state"]) == {"/scan": "scan", "uuv/1/state": "uuv-1-state"}


def test_tables_of_a_bag_without_some_topics(tmp_path: Path) -> None:
    """A directory that `ros2 bag` makes, by `info`, `export` and `diff`. Topics have odd names, one of them twice."""
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("bag_0.mcap", "bag_1.mcap"):
        with (bag / name).open("wb") as file:
            writer = Writer(file)
            writer.start()
            for topic in ("/scan", "scan", "/camera", "/camera/info"):
                writer.add_message(writer.register_channel(topic, "json", 0), 1, b"{}", 1)
            writer.finish()
    (bag / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [bag_0.mcap, bag_1.mcap]}"
    )
    made = invoke("export", bag, "--csv", tmp_path / "t", "--exclude", "/camera*")
    assert made.exit_code == 0, made.output
    assert sorted(path.name for path in (tmp_path / "t").iterdir()) == ["export.json", "scan-2.csv", "scan.csv"]
    assert len((tmp_path / "t" / "scan.csv").read_text().splitlines()) == 3
    size = sum(path.stat().st_size for path in bag.glob("*.mcap"))
    found = json.loads(invoke("info", bag, "--json").stdout)
    assert (found["messages"], found["bytes"]) == (8, size)
    assert invoke("diff", bag, bag).stdout == "the same bit for bit (8 messages)\n"
    assert "recover each by itself" in invoke("recover", bag).stderr
    (bag / "metadata.yaml").unlink()
    assert "name one of them" in invoke("info", bag).stderr
    (bag / "bag_1.mcap").unlink()
    assert "4 messages" in invoke("info", bag).stdout  # its recorder was killed


# Lists within lists, whose text would have 2^40 letters.
LAUGHS = ", ".join(["{a0: &a0 [x, x]", *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40))])
LAUGHS += ", storage_identifier: *a39, relative_file_paths: [a.mcap]}"


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ("{storage_identifier: sqlite3, relative_file_paths: [a_0.db3]}", "the storage 'sqlite3'"),
        ("{storage_identifier: mcap, relative_file_paths: [a.mcap.zstd]}", "files such as a.mcap.zstd"),
        ("{storage_identifier: mcap, relative_file_paths: [../../secret.mcap]}", "bag/secret.mcap: No such file"),
        ("{storage_identifier: mcap, relative_file_paths: [1]}", "not that of a bag"),
        ("{storage_identifier: mcap, relative_file_paths: []}", "not that of a bag"),
        ("{storage_identifier: mcap, relative_file_paths: [a.mcap, b.mcap, x/a.mcap]}", "names a.mcap 2 times"),
        ("[", "not that of a bag"),
        (LAUGHS, "not that of a bag"),
    ],
)
def test_bags_that_cannot_be_read(told: str, words: str, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {told}")
    found = invoke("info", bag)
    assert found.exit_code == 2 and words in found.stderr


def test_no_name_of_a_stranger_reaches_the_terminal(tmp_path: Path) -> None:
    """Escapes, and line breaks that would begin a line of ours: in names, encodings, and the heading of a trace."""
    evil = "x\x1b]0;pwn\x07\x9b2J\r\u202enwp\nfleet: 3 messages"
    path, trace = tmp_path / "x.mcap", tmp_path / "trace.csv"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(evil, evil)
        schema = writer.register_schema(evil, "jsonschema", b"{}")
        writer.add_message(writer.register_channel(evil, "json", schema), 1, b"{}", 1)
        writer.add_message(writer.register_channel(f"/{evil}", evil, 0), 1, b"{}", 1)
        writer.add_metadata("run", {evil: evil, "scenario": evil, "tick_ns": evil})
        writer.finish()
    trace.write_text(f"{evil.splitlines()[0]} [s],delivered\n0,0\n")
    commands = (["info"], ["export", "--csv", tmp_path / "t"], ["diff", path], ["verify"], ["replay", "--topics", "y"])
    for verb, *more in commands:
        assert_harmless(invoke(verb, path, *more).output)
    assert_harmless(invoke("fit", trace).output)
    document = invoke("info", path, "--json").stdout
    assert_harmless(document)
    assert json.loads(document)["run"][evil] == evil
    assert not any(line.startswith("fleet:") for line in invoke("info", path).stdout.splitlines())


def assert_harmless(text: str) -> None:
    assert text and all(c.isprintable() or c == "\n" for c in text), ascii(text)
