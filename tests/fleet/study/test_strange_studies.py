"""A study that comes from anybody: every reader refuses in words what no study writes, before it fills the memory."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as some
from made_up_study import LOSS, made_up, usual

from fleet.cli.main import cli
from fleet.parquet_pages import column_chunks, unpacked_bytes
from fleet.study.errors import StudyError
from fleet.study.parquet_file import MOST_BYTES, MOST_ROWS, read_table
from fleet.study.record import NAME
from fleet.study.spec import MOST_ALLOWED
from fleet.study.store import Store
from fleet.study.study import open_study

READERS: dict[str, Callable[[Path], Any]] = {
    "table": lambda directory: open_study(directory).to_pandas(),
    "arrays": lambda directory: open_study(directory).to_xarray(),
    "summary": lambda directory: open_study(directory).summary("e_rms_m"),
    "compare": lambda directory: open_study(directory).compare("network.links.*.loss", 0.0, 30.0, "passed"),
    "plot": lambda directory: open_study(directory).plot("e_rms_m"),
    "missing": lambda directory: open_study(directory).missing,
}
COMMANDS = (["report"], ["plot"], ["sweep"])


def part_of(store: Store) -> Path:
    return next((store.directory / "runs").glob("*.parquet"))


def changed(file: Path, column: str, values: list[Any]) -> None:
    """Put other values into a column of a file."""
    whole = pq.read_table(file)
    at = whole.schema.get_field_index(column)
    pq.write_table(whole.set_column(at, whole.schema.field(at), pa.array(values, whole.schema.field(at).type)), file)


def assert_refused(directory: Path, words: str) -> None:
    """By every reader and every command, in one line."""
    for reader in READERS.values():
        with pytest.raises(StudyError, match=words):
            reader(directory)
    for command in COMMANDS:
        found = CliRunner().invoke(cli, [*command, str(directory)])
        assert found.exit_code == 2 and found.stderr.count("\n") == 1, (command, found.output)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return made_up(tmp_path / "study", LOSS, row=usual)


def test_a_word_that_stands_once_and_counts_in_every_row(store: Store) -> None:
    """One value of 20 MB in a dictionary: a file of some kB, and 20 GB when each row has it."""
    part = part_of(store)
    rows = pq.read_table(part).slice(0, 1).take([0] * 1000)
    word = pa.DictionaryArray.from_arrays(pa.array([0] * 1000), pa.array(["x" * 20_000_000]))
    rows = rows.set_column(rows.schema.get_field_index("reason"), "reason", word)
    pq.write_table(rows, part, compression="zstd", store_schema=False, write_statistics=False)
    assert part.stat().st_size < 100_000
    before = pa.total_allocated_bytes()
    with pytest.raises(StudyError, match=rf"holds 200000\d+ bytes of texts, more than a study writes: {MOST_BYTES}"):
        store.table()
    assert pa.total_allocated_bytes() - before < 100_000_000
    with pytest.raises(StudyError, match=r"runs of points|two rows"):  # columns that nobody asks for are not unpacked
        store.table(["point", "seed"])


def test_pages_that_unpack_to_more_than_the_end_of_the_file_says(store: Store) -> None:
    part = part_of(store)
    rows = pq.read_table(part).slice(0, 1)
    at = rows.schema.get_field_index("reason")
    rows = rows.set_column(at, rows.schema.field(at), pa.array(["x" * (MOST_BYTES + 1)]))
    pq.write_table(rows, part, compression="zstd", write_statistics=False)
    with pytest.raises(StudyError, match="bytes, unpacked, more than a study writes"):
        store.table()


def test_too_many_rows_groups_or_columns(store: Store) -> None:
    part = part_of(store)
    whole = pq.read_table(part)
    pq.write_table(whole.slice(0, 1).take([0] * (MOST_ROWS + 1)), part)
    with pytest.raises(StudyError, match=rf"holds {MOST_ROWS + 1} rows, more than a study writes: {MOST_ROWS}"):
        store.table()
    pq.write_table(whole.slice(0, 1).take([0] * 1001), part, row_group_size=1)
    with pytest.raises(StudyError, match="holds 1001 groups of rows"):
        store.table()
    pq.write_table(pa.table({f"c{n}": [1] for n in range(3000)}), part)
    with pytest.raises(StudyError, match=r"has other columns than study.json says"):
        store.table()


@pytest.mark.parametrize("which", ["points", "part", "record", "folder of parts"])
def test_a_named_pipe_is_refused_and_not_waited_for(which: str, store: Store) -> None:
    part = part_of(store)
    path = {"points": store.directory / "points.parquet", "part": part, "record": store.directory / NAME,
            "folder of parts": part.parent}[which]  # fmt: skip
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    os.mkfifo(path)
    assert_refused(store.directory, "Not a directory" if path == part.parent else "it is a pipe, not a file")


def test_a_part_that_was_copied_counts_no_run_twice(store: Store) -> None:
    part = part_of(store)
    shutil.copy(part, part.with_name("part-000077.parquet"))
    assert_refused(store.directory, r"point 0 has two rows with seed 1, and one was expected .*was a file copied")
    part.with_name("part-000077.parquet").rename(part.with_name("part-0000001.parquet"))
    assert_refused(store.directory, "two files with the number of part-0+1.parquet")


@pytest.mark.parametrize("status", ["great", "PASS", "", None, "\x1b[2J"])
def test_a_status_that_no_run_has(status: str | None, store: Store) -> None:
    part = part_of(store)
    changed(part, "status", [status, *pq.read_table(part)["status"].to_pylist()[1:]])
    assert_refused(store.directory, "a run has the status .*, expected one of failed, pass, check_failed")


def test_a_text_that_is_none(store: Store) -> None:
    part = part_of(store)
    whole = pq.read_table(part)
    data = pa.array([b"\xff"] * len(whole), pa.binary())
    texts = pa.Array.from_buffers(pa.string(), len(data), data.buffers())
    at = whole.schema.get_field_index("reason")
    pq.write_table(whole.set_column(at, whole.schema.field(at), texts), part)
    with pytest.raises(StudyError, match=r"cannot be read: .*UTF"):
        store.table()


def test_millions_of_seeds_axes_or_checks(store: Store) -> None:
    file = store.directory / NAME
    record = json.loads(file.read_text("utf-8"))
    file.write_text(json.dumps(record | {"seeds": list(range(3_000_000))}, separators=(",", ":")), "utf-8")
    with pytest.raises(StudyError, match=f"has 3000000 seeds: at most {MOST_ALLOWED} are possible"):
        open_study(store.directory)
    file.write_text(json.dumps(record | {"seeds": list(range(10**9, 10**9 + 3_000_000))}), "utf-8")
    with pytest.raises(StudyError, match="it is larger than 32 MB"):
        open_study(store.directory)
    for key, value in (("axes", {"key": "a", "unit": None}), ("checks", "c"), ("columns", {"name": "n", "unit": "m"})):
        file.write_text(json.dumps(record | {key: [value] * 1001}), "utf-8")
        with pytest.raises(StudyError, match=f"has 1001 {key}: at most 1000 are possible"):
            open_study(store.directory)


def test_a_file_that_is_cut_off_or_no_parquet(store: Store) -> None:
    part = part_of(store)
    data = part.read_bytes()
    for damaged in (b"", b"PAR1", data[:100], data[:-5], data[:-8] + b"\xff\xff\xff\x7fPAR1", os.urandom(1000)):
        part.write_bytes(damaged)
        with pytest.raises(StudyError, match=r"cannot be read|more than a study writes|is damaged"):
            store.table()


@given(at=some.integers(0, 10**6), byte=some.integers(0, 255))
def test_a_changed_byte_gives_rows_or_words(at: int, byte: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    store = _once(tmp_path_factory)
    part = part_of(store)
    whole = part.read_bytes()
    damaged = bytearray(whole)
    damaged[at % len(damaged)] = byte
    part.write_bytes(damaged)
    with suppress(StudyError):
        store.table()
    part.write_bytes(whole)


_made: list[Store] = []


def _once(factory: pytest.TempPathFactory) -> Store:
    if not _made:
        _made.append(made_up(factory.mktemp("strange") / "study", LOSS, row=usual))
    return _made[0]


@given(
    rows=some.lists(some.tuples(some.none() | some.text(max_size=50), some.none() | some.floats()), max_size=200),
    group=some.integers(1, 50),
    page=some.integers(1, 2000),
    version=some.sampled_from(["1.0", "2.0"]),
    packed=some.sampled_from(["none", "zstd", "snappy"]),
)
def test_the_size_of_pages_is_that_of_what_they_unpack_to(
    rows: list[tuple[str | None, float | None]], group: int, page: int, version: str, packed: str
) -> None:
    """The headers take the rest of what the end of the file says."""
    table = pa.table(
        {"a": pa.array([a for a, _ in rows], pa.string()), "b": pa.array([b for _, b in rows], pa.float64())}
    )
    file = BytesIO()
    pq.write_table(
        table, file, row_group_size=group, data_page_size=page, data_page_version=version, compression=packed
    )
    about = pq.ParquetFile(file).metadata
    groups = column_chunks(footer(file.getvalue()))
    assert len(groups) == about.num_row_groups
    for k, chunks in enumerate(groups):
        for column, chunk in enumerate(chunks):
            said = about.row_group(k).column(column)
            assert (chunk.path, chunk.values, chunk.size) == ("ab"[column], said.num_values, said.total_compressed_size)
            found = unpacked_bytes(file, chunk)
            assert 0 <= found <= said.total_uncompressed_size
            if packed == "none":
                headers = said.total_uncompressed_size - found
                assert headers <= 60 * (3 + said.num_values)


def footer(data: bytes) -> bytes:
    """What a Parquet file says of itself at its end."""
    return data[-8 - int.from_bytes(data[-8:-4], "little") : -8]


def test_columns_on_which_pyarrow_ends_the_process(tmp_path: Path) -> None:
    """A byte of the sizes that stand beside the levels is another: pyarrow 26 throws where nothing catches."""
    schema = pa.schema([pa.field("a", pa.string())])
    pq.write_table(pa.table({"a": ["x", None, "y"]}, schema=schema), tmp_path / "x.parquet")
    whole = (tmp_path / "x.parquet").read_bytes()
    begin = len(whole) - 8 - len(footer(whole))
    for at in range(begin, len(whole) - 8):
        for change in (0x01, 0x10, 0x20):
            damaged = bytearray(whole)
            damaged[at] ^= change
            (tmp_path / "x.parquet").write_bytes(damaged)
            with suppress(StudyError):
                read_table(tmp_path / "x.parquet", schema)


def test_what_is_written_is_read_again_to_the_byte(tmp_path: Path) -> None:
    schema = pa.schema([pa.field("a", pa.string()), pa.field("b.c", pa.float64(), metadata={"unit": "m"})])
    table = pa.table({"a": ["x", None, "ä" * 1000], "b.c": [1.0, None, float("nan")]}, schema=schema)
    pq.write_table(table, tmp_path / "x.parquet")
    found = read_table(tmp_path / "x.parquet", schema)
    assert found.schema.equals(schema, check_metadata=True)
    assert str(found.to_pylist()) == str(table.to_pylist())
    assert read_table(tmp_path / "x.parquet", schema, ["b.c"]).column_names == ["b.c"]
