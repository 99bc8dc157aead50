"""The page about a study: what it says, and that a stranger's study adds no markup and fetches nothing."""

from __future__ import annotations

import json
import re
import shlex
import sqlite3
from contextlib import closing
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from html_page import Page, words_of
from made_up_study import CONTROLLER, LOSS, made_up, usual, with_holes

from fleet.addons.studies.pictures import report
from fleet.addons.studies.pictures.report import write
from fleet.addons.studies.record import BorderRecord, read_record
from fleet.addons.studies.store import FILE, Store

pytestmark = pytest.mark.usefixtures("coarse")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """One picture, since they take most of the time."""
    whole = report.draw
    monkeypatch.setattr(report, "draw", lambda *arguments: [next(iter(whole(*arguments)))])


def page_of(store: Store, *measures: str) -> str:
    path = store.directory.parent / "page.html"
    write(path, store, measures)
    return path.read_text("utf-8")


def test_the_page_of_a_study_of_a_border_names_the_command_that_goes_on_with_it(tmp_path: Path) -> None:
    store = made_up(tmp_path / "study", LOSS, row=with_holes)
    store.record.border = BorderRecord(log=False)
    said = words_of(page_of(store, "formation_final_m"))
    assert f"fleet boundary {store.directory}" in said
    assert "runs | 6, of which 6 are made" in said
    assert "not made yet" not in said and "fleet sweep" not in said


def test_paths_are_those_from_the_folder_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page for others does not tell where its author keeps files."""
    (tmp_path / "studies").mkdir()
    store = made_up(tmp_path / "studies" / "s", LOSS, row=with_holes)
    monkeypatch.chdir(tmp_path)
    text = page_of(store, "formation_final_m")
    assert str(tmp_path) not in text and "fleet sweep studies/s" in text


def test_the_page_says_what_was_run_and_what_came_of_it(tmp_path: Path) -> None:
    store = made_up(tmp_path / "study-20261122-101500", LOSS, CONTROLLER, row=with_holes)
    said = words_of(page_of(store, "formation_final_m"))
    for words in (
        "scenario | small | changed for every run | --set network.links={'*': delay 50ms loss 10%} --set name=small",
        "seeds of each | 1 to 3 | runs | 18, of which 12 are made and 4 have no result",
        "begun | 2026-11-22 10:15:00 UTC",
        "wall time of the runs | 6 s of one core, 0.5 s per run",
        "made by | uuv-fleet 0, plain cores: 12 runs",
        "6 runs are not made yet",
        "network.links.*.loss | % | 0 %, 30 %, 60 %",
        "0 | 0 | nboc | 2 | 0 | 100 %   34..100 % | inf (of 1 runs)",
        "2 | 30 | nboc | 2 | 2 | - | -",
        "boc - nboc | runs that passed [%] | 4 | only nboc: 0, only boc: 0",
        "boc - nboc | final formation error of the worst vehicle [m] | 4 | 0.05 | 25 % | 2 of 4 pairs differ: fewer",
        "failed | 4 | point 2, seed 1 | took longer than 1 s",
    ):
        assert words in said, said


def test_the_command_that_makes_a_run_again_names_the_study(tmp_path: Path) -> None:
    store = made_up(tmp_path / "it's $HOME", LOSS, row=usual)
    (command,) = re.findall(r"<pre>(python .*?)</pre>", page_of(store), re.DOTALL)
    program, option, code = shlex.split(unescape(command))
    assert (program, option) == ("python", "-c")
    called: list[Any] = []

    class Fake:
        def open_study(self, directory: str) -> Any:
            called.append(directory)
            return self

        def rerun(self, *run: int, seed: int) -> None:
            called.append((*run, seed))

    exec(code.removeprefix("import fleet; "), {"fleet": Fake()})
    assert called == [str(store.directory), (1, 1)]  # the first that fails


def test_a_strangers_study_cannot_bring_markup_or_fetch_anything(tmp_path: Path) -> None:
    """Every text of a study that the page shows is text on the page."""
    evil = "<script>alert(1)</script><img src=http://x onerror=alert(2)>\"'&{{ 7*7 }}"
    store = made_up(tmp_path / f"<b>{'x'}", LOSS, "title=<i>a, <i>b", row=lambda values, seed: usual(values, seed) | {
        "status": "failed" if seed == 1 else "broken", "reason": evil})  # fmt: skip
    file = store.directory / "study.json"
    record = json.loads(file.read_text("utf-8"))
    record |= {"scenario": evil, "command": evil, "made_by": evil, "checks": [evil]}
    record["axes"][0] |= {"key": evil, "unit": evil}
    file.write_text(json.dumps(record), "utf-8")
    rows, points = list(store.rows(["wall_s"], details=True)), store.points
    with closing(sqlite3.connect(store.directory / FILE)) as database, database:  # the tables that study.json calls for
        for statement in (
            "DROP TABLE points",
            "DROP TABLE runs",
            *Store(store.directory, read_record(store.directory))._tables,
        ):
            database.execute(statement)
        values = [(point.number, *point.values.values(), point.scenario) for point in points]
        database.executemany("INSERT INTO points VALUES (?, ?, ?, ?)", values)
    hostile = Store.open(store.directory)
    for row in rows:
        row.version = row.cores = evil
    hostile.add(rows)
    page = page_of(hostile)
    assert "alert(1)" in words_of(page)
    assert "{{ 7*7 }}" in words_of(page)
    tags = Page(page).tags  # refuses a script
    assert {tag for tag, _ in tags}.isdisjoint({"i", "u", "b"})
    for tag, attributes in tags:
        assert all(not name.startswith("on") for name in attributes), tag
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#"))


def test_many_points_and_reasons_are_cut_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "MOST_POINTS", 2)
    monkeypatch.setattr(report, "MOST_REASONS", 1)
    row = {"status": "failed"}
    store = made_up(tmp_path / "s", LOSS, row=lambda values, seed: row | {"reason": f"no {seed}"})
    said = words_of(page_of(store))
    assert "1 more, which fleet.open_study has" in said
    assert "2 more, reasons of fewer runs" in said


def test_the_page_begins_with_what_passed_a_picture_and_the_reason(tmp_path: Path) -> None:
    def row(values: Any, seed: int) -> Any:
        found = usual(values, seed)
        return {**found, "check.tumbled": found["passed"], "check.deaths": True, "check.qp_infeasible": seed > 1}

    page = page_of(made_up(tmp_path / "study", LOSS, row=row), "formation_final_m")
    assert "3 of 9 runs passed (33%; of a point 0% to 100%)" in page
    places = [page.index(part) for part in ("runs passed (", "<figure", ">Why runs failed<", ">What was run<")]
    assert places == sorted(places)
    assert "check | runs that failed it | share | tumbled | 6 | 67% | qp_infeasible | 3 | 33%" in words_of(page)
