"""A study that comes from anybody: every reader refuses in words what no study writes, before it fills the memory."""

from __future__ import annotations

import json
import os
import resource
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as some
from made_up_study import LOSS, damage, made_up, usual
from refusals import check_refusals
from tool import invoke

import fleet
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.record import NAME, read_record
from fleet.addons.studies.row import Row
from fleet.addons.studies.spec import MOST_ALLOWED
from fleet.addons.studies.store import FILE, Store
from fleet.addons.studies.values import AxisValue
from fleet.errors import printable
from netem.limits import STUDY_ROWS

READERS: dict[str, Callable[[Path], Any]] = {
    "table": lambda directory: fleet.open_study(directory).to_pandas(),
    "arrays": lambda directory: fleet.open_study(directory).to_xarray(),
    "summary": lambda directory: fleet.open_study(directory).summary("e_rms_m"),
    "compare": lambda directory: fleet.open_study(directory).compare("network.links.*.loss", 0.0, 30.0, "passed"),
    "plot": lambda directory: fleet.open_study(directory).plot("e_rms_m"),
    "missing": lambda directory: fleet.open_study(directory).missing,
}
COMMANDS = (["report"], ["plot"], ["sweep"])


def assert_refused(directory: Path, words: str) -> None:
    """By every reader and every command, in one line."""
    for reader in READERS.values():
        with pytest.raises(StudyError, match=words):
            reader(directory)
    for command in COMMANDS:
        found = invoke(*command, directory)
        assert found.exit_code == 2 and found.stderr.count("\n") == 1, (command, found.output)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return made_up(tmp_path / "study", LOSS, row=usual)


def test_what_no_study_writes(store: Store, tmp_path: Path) -> None:
    """Into the database, and into the record beside it."""
    copy = tmp_path / "copy"
    record = json.loads((store.directory / NAME).read_text("utf-8"))

    def fresh() -> None:
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(store.directory, copy)

    def stated(statement: str) -> None:
        fresh()
        damage(copy, statement)
        fleet.open_study(copy).to_pandas()

    def recorded(change: str) -> None:
        fresh()
        (copy / NAME).write_text(json.dumps(record | yaml.safe_load(change)), "utf-8")
        fleet.open_study(copy)

    check_refusals("study/statements", stated, hide={str(copy): "STUDY"})
    check_refusals("study/records", recorded, hide={str(copy): "STUDY"})


def test_every_reader_refuses_it(store: Store) -> None:
    damage(store.directory, "UPDATE runs SET status = 'great'")
    assert_refused(store.directory, "a value of another type in runs")


def test_a_text_or_a_file_that_is_too_long(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    damage(store.directory, "UPDATE runs SET reason = printf('%.*c', 20000000, 'x') WHERE point = 0 AND seed = 1")
    with pytest.raises(StudyError, match="too big"):
        fleet.open_study(store.directory).to_pandas()
    monkeypatch.setattr("fleet.addons.studies.store.STUDY_ROWS", STUDY_ROWS._replace(bytes=1_000_000))
    with pytest.raises(StudyError, match=r"is larger than 0.001 GB"):
        fleet.open_study(store.directory).to_pandas()


def test_millions_of_seeds_axes_or_checks(store: Store) -> None:
    file = store.directory / NAME
    record = json.loads(file.read_text("utf-8"))
    without = json.dumps(record | {"seeds": []})

    def seeds(one: str, count: int) -> None:
        listed = (f"{one}," * count).removesuffix(",")
        file.write_text(without.replace('"seeds": []', f'"seeds": [{listed}]'), "utf-8")

    seeds("7", 3_000_000)
    with pytest.raises(StudyError, match=f"has 3000000 seeds: at most {MOST_ALLOWED} are possible"):
        fleet.open_study(store.directory)
    seeds("1000000000", 3_000_000)
    with pytest.raises(StudyError, match="it is larger than 32 MB"):
        fleet.open_study(store.directory)
    for key, value in (("axes", {"key": "a", "unit": None}), ("checks", "c"), ("columns", {"name": "n", "unit": "m"})):
        file.write_text(json.dumps(record | {key: [value] * 1001}), "utf-8")
        with pytest.raises(StudyError, match=f"has 1001 {key}: at most 1000 are possible"):
            fleet.open_study(store.directory)


def test_a_file_that_is_cut_off_or_no_database(store: Store) -> None:
    file = store.directory / FILE
    data = file.read_bytes()
    for damaged in (b"", b"SQLite format 3\0", data[:100], data[:5000], data[:-4096], os.urandom(1000)):
        file.write_bytes(damaged)
        with pytest.raises(StudyError, match=r"cannot be read|is damaged"):
            Store.open(store.directory).frame()


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return made_up(tmp_path_factory.mktemp("strange") / "study", LOSS, row=usual)


@given(at=some.integers(0, 10**6), byte=some.integers(0, 255))
def test_a_changed_byte_gives_rows_or_words(at: int, byte: int, kept: Store) -> None:
    file = kept.directory / FILE
    whole = file.read_bytes()
    damaged = bytearray(whole)
    damaged[at % len(damaged)] = byte
    file.write_bytes(damaged)
    with suppress(StudyError):
        Store.open(kept.directory).frame()
    file.write_bytes(whole)


KILLED = """
import os, sqlite3, sys
file = sqlite3.connect(sys.argv[1])
file.execute("PRAGMA cache_size = 1")
file.execute("BEGIN")
file.execute("UPDATE runs SET reason = printf('%.*c', 100000, 'x')")
os._exit(0)
"""


def test_a_batch_in_which_a_program_was_killed_is_undone(store: Store) -> None:
    """Its first pages are in the file, and what was there before is in the journal beside it."""
    from pandas.testing import assert_frame_equal

    before, file = store.frame(), store.directory / FILE
    whole = file.read_bytes()
    subprocess.run([sys.executable, "-c", KILLED, str(file)], check=True)
    journal = store.directory / f"{FILE}-journal"
    assert journal.exists() and file.read_bytes() != whole
    left = journal.read_bytes()
    journal.write_bytes(left + bytes.fromhex("d9d505f920a163d7"))  # as if it named a file that is to be deleted
    with pytest.raises(StudyError, match="journal is damaged"):
        Store.open(store.directory)
    journal.write_bytes(left)
    assert_frame_equal(Store.open(store.directory).frame(), before)
    assert not journal.exists()


@pytest.mark.parametrize("pages", [0x20000000, 0xFFFFFFFF])
def test_a_journal_of_a_stranger_makes_no_file_larger(pages: int, store: Store) -> None:
    """It says how many pages the database had before, up to 17.6 TB."""
    file = store.directory / FILE
    whole = file.read_bytes()
    page, nonce = whole[:4096], 12345
    check = nonce + sum(page[at] for at in range(len(page) - 200, 0, -200))
    head = bytes.fromhex("d9d505f920a163d7") + struct.pack(">5I", 0xFFFFFFFF, nonce, pages, 512, 4096)
    record = struct.pack(">I", 1) + page + struct.pack(">I", check & 0xFFFFFFFF)
    (store.directory / f"{FILE}-journal").write_bytes(head.ljust(512, b"\0") + record)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.raises(StudyError, match="was left in the middle of a batch, and cannot be mended"):
        Store.open(store.directory)
    assert file.stat().st_size == len(whole)
    assert resource.getrlimit(resource.RLIMIT_FSIZE) == limit


def test_texts_that_are_too_much_together(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.store._MOST_TEXTS", 3_000_000)
    assert len(Store.open(store.directory).frame()) == 9
    damage(store.directory, "UPDATE runs SET reason = printf('%.*c', 400000, 'x')")
    with pytest.raises(StudyError, match="has 4 MB of texts, too many to be read at once"):
        Store.open(store.directory).frame()
    assert sum(1 for _ in Store.open(store.directory).rows(details=True)) == 9  # which are not held
    damage(store.directory, "UPDATE points SET scenario = printf('%.*c', 1100000, 'x')")
    with pytest.raises(StudyError, match="has 3 MB of texts"):
        _ = Store.open(store.directory).points


def test_no_terminal_obeys_the_words_of_sqlite(store: Store) -> None:
    file = store.directory / FILE
    file.write_bytes(file.read_bytes().replace(b"INTEGER PRIMARY KEY", b"INTEGER \x1b]0;hi\x07 KEY"))
    with pytest.raises(StudyError) as caught:
        Store.open(store.directory).frame()
    assert printable(str(caught.value)) == str(caught.value)
    for command in (*COMMANDS, ["export", "--csv", str(store.directory / "out")]):
        assert "\x1b" not in invoke(*command, store.directory).output


def test_names_that_differ_only_in_their_case_are_two(tmp_path: Path) -> None:
    store = made_up(tmp_path / "study", "title=a, b", row=lambda _, seed: {"status": "pass", "passed": True})
    file = store.directory / NAME
    record = json.loads(file.read_text("utf-8"))
    columns = [*record["columns"], {"name": "E_RMS_M", "unit": "m"}]
    file.write_text(json.dumps(record | {"columns": columns}), "utf-8")
    again = Store.create(tmp_path / "again", read_record(store.directory), [({"title": AxisValue("a")}, "text")])
    again.add([Row(point=0, seed=1, status="pass", numbers={"e_rms_m": 1.0, "E_RMS_M": 2.0})])
    (row,) = Store.open(again.directory).rows(["E_RMS_M", "e_rms_m"])
    assert row.numbers == {"E_RMS_M": 2.0, "e_rms_m": 1.0}
