"""What every reader of a user's file refuses in words: what is no file, what is too large, and what is damaged.

A reader that opens a pipe waits for ever, until the limit of time for tests ends it.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from shutil import copytree
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process_runs import Alone
from live_directory import CONNECTION, live_directory
from made_up_study import LOSS, made_up, usual
from repository import ROOT

from agents.errors import AgentError
from agents.join_file import JoinFile
from fleet.addons.hosts.certificates import _read as read_pem
from fleet.addons.hosts.rendezvous import new_credentials, read_credentials
from fleet.addons.studies.store import Store
from fleet.errors import FleetError
from fleet.execution.connection import find
from fleet.mcap.reader import LogReader
from fleet.replay.observed import read_observed
from fleet.result.file import read_result
from fleet.scenario.loading import load_scenario
from fleet.scenario.sections.modem_files import load_modem
from fleet.scenario.sections.trace_table import read_trace
from fleet.scenario.sections.vehicle_files import load_vehicle
from netem.errors import NetemError
from netem.wire.messages import PROTOCOL_VERSION

JOIN = {"version": PROTOCOL_VERSION, "vehicle": 3} | CONNECTION


class Reader(NamedTuple):
    """Who reads a file of a user, and of what the file consists."""

    read: Callable[[Path], Any]
    content: bytes | Path = b""  # of a file that is taken; a path: that of a shipped file
    folder: str = ""  # in which such a file lies already: that of a run, a study or a live run
    file: str = "file"


def every_message(path: Path) -> None:
    reader = LogReader(path)
    if not list(reader) or reader.missing:
        raise FleetError(f"{path}: {reader.missing or 'it holds no message'}")


READERS = {
    "scenario": Reader(load_scenario, ROOT / "fleet/scenario/shipped/ideal.yaml"),
    "vehicle": Reader(lambda path: load_vehicle(str(path)), ROOT / "world/vehicles/paper.toml", file="file.toml"),
    "modem": Reader(lambda path: load_modem(str(path)), ROOT / "netem/modems/s2c.toml", file="file.toml"),
    "trace": Reader(read_trace, b"time [s],delivered\n0,1\n1,0\n"),
    "join file": Reader(JoinFile.read, json.dumps(JOIN).encode()),
    "credentials": Reader(lambda path: read_credentials(path, 4), json.dumps(new_credentials("a", 4)).encode()),
    "certificate": Reader(read_pem, b"-----BEGIN CERTIFICATE-----\n"),
    "observe.json": Reader(read_observed, json.dumps(CONNECTION).encode()),
    "connection.json": Reader(lambda path: find(str(path.parent)), folder="live", file="connection.json"),
    "log": Reader(every_message, folder="run", file="run.mcap"),
    "result": Reader(lambda path: read_result(path.parent), folder="run", file="result.json"),
    "study": Reader(lambda path: Store.open(path.parent), folder="study", file="study.json"),
    "database": Reader(lambda path: Store.open(path.parent).frame(), folder="study", file="study.sqlite"),
}


def become(kind: str, path: Path) -> None:
    """Put something else in the place of a file."""
    whole = path.read_bytes()
    path.unlink()
    if kind == "a pipe":
        os.mkfifo(path, 0o600)
    elif kind == "a directory":
        path.mkdir()
    elif kind in ("/dev/zero", "/dev/null"):
        path.symlink_to(kind)
    elif kind == "too large":
        path.touch(0o600)
        os.truncate(path, 1 << 40)  # costs nothing to make, and would cost much to read
    else:
        path.touch(0o600)
        path.write_bytes({
            "empty": b"", "cut off": whole[: len(whole) * 2 // 3], "not text": b"\xff\xfe" + whole,
            "deep lists": b"[" * 100_000, "deep mappings": b'{"a":' * 20_000,
        }[kind])  # fmt: skip


# Of each kind of file, what the words of its refusal say. Damage has other words for each reader.
KINDS = {
    "a pipe": "it is a pipe, not a file|no regular file|it is no file",
    "a directory": "[Ii]s a directory|no regular file|it is no file",
    "/dev/zero": "it is a device, not a file|no regular file|it is no file",
    "/dev/null": "it is a device, not a file|no regular file|it is no file",
    "too large": "is larger than [0-9.]+ [MG]B|does not begin with MCAP's magic bytes",
    "empty": ".",
    "cut off": ".",
    "not text": ".",
    "deep lists": ".",
    "deep mappings": ".",
}
# The first lines of a trace are one, too, and whether text is a certificate is for OpenSSL to say.
TAKEN = {
    ("trace", "cut off"),
    *(("certificate", kind) for kind in ("empty", "cut off", "deep lists", "deep mappings")),
}


@pytest.fixture
def path(who: str, made: Alone, tmp_path: Path) -> Iterator[Path]:
    """A file that its reader takes."""
    reader = READERS[who]
    if reader.folder == "live":
        with live_directory(tmp_path) as live:
            yield live / reader.file
        return
    if reader.folder == "run":
        copytree(made("paper", "duration=2 s", "checks={}").directory, tmp_path / "run")
    elif reader.folder == "study":
        made_up(tmp_path / "study", LOSS, row=usual)
    found = tmp_path / reader.folder / reader.file
    if not reader.folder:
        found.touch(0o600)
        found.write_bytes(content_of(reader))
    yield found


def content_of(reader: Reader) -> bytes:
    return reader.content if isinstance(reader.content, bytes) else reader.content.read_bytes()


@pytest.mark.parametrize("who", READERS)
def test_a_reader_takes_its_file_and_refuses_all_else_in_words(who: str, path: Path) -> None:
    READERS[who].read(path)
    whole = path.read_bytes()
    for kind, words in KINDS.items():
        become(kind, path)
        if (who, kind) not in TAKEN:
            with pytest.raises((AgentError, FleetError, NetemError, OSError)) as refused:
                READERS[who].read(path)
            said = str(refused.value)
            if who == "connection.json":  # `fleet ls` looks at every run, and leaves out the one with such a file
                words = "is no live run: there is no usable connection.json"
            assert re.search(words, said) and len(said) < 1000, (kind, said)
        path.rmdir() if kind == "a directory" else path.unlink()
        path.touch(0o600)
        path.write_bytes(whole)


SMALL = [who for who, reader in READERS.items() if reader.content]
PIECES = [b"", b"-", b"9" * 400, b"nan", b"1e999", b"null", b"[", b"{}", b'"', b",", b"=", b"\n", b"\xff", b"\0", b"ms"]
CHANGES = st.lists(st.tuples(st.floats(0, 1), st.sampled_from(PIECES) | st.binary(max_size=4)), min_size=1, max_size=4)


@given(st.sampled_from(SMALL), CHANGES)
def test_a_changed_file_is_taken_or_refused_in_words(
    tmp_path_factory: pytest.TempPathFactory, who: str, changes: list[tuple[float, bytes]]
) -> None:
    reader = READERS[who]
    path = tmp_path_factory.getbasetemp() / f"changed-{reader.file}"
    data = content_of(reader)
    for place, piece in changes:
        at = int(place * len(data))
        data = data[:at] + piece + data[at + 1 :]
    path.touch(0o600)
    path.write_bytes(data)
    try:
        reader.read(path)
    except (AgentError, FleetError, NetemError) as error:
        assert 0 < len(str(error)) < 5000  # noqa: PT017
