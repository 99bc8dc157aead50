"""What pictures are drawn from: the same estimates as the table's, runs that lack a number, and pairs of runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any

import pytest
from made_up_study import CONTROLLER, DELAY, LOSS, damage, made_up, usual, with_holes
from msgspec.structs import replace

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.pictures.gallery import draw
from fleet.addons.studies.pictures.points import PASSED, Lack, load
from fleet.addons.studies.record import write_record
from fleet.addons.studies.spec import StudySpec
from fleet.addons.studies.statistics import pass_rate
from fleet.addons.studies.store import Store
from fleet.addons.studies.study import Study


def test_estimates_are_those_of_the_table(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, CONTROLLER, row=usual, seeds=4)
    points = load(store, ["e_rms_m"])
    rows = Study(store).summary("e_rms_m")
    assert len(rows) == len(points.keys) == 6
    for key, row in zip(points.keys, rows, strict=True):
        assert points.quantity(PASSED).cells[key].estimate == row.passed
        assert points.quantity("e_rms_m").cells[key].estimate == row.medians["e_rms_m"]
    assert points.quantity("e_rms_m").what == "RMS of the consensus error over the last 10 s, worst vehicle [m]"


def test_runs_that_lack_a_number_are_counted_by_reason(tmp_path: Path) -> None:
    points = load(made_up(tmp_path / "s", LOSS, row=with_holes))
    cells = points.quantity("formation_final_m").cells
    assert cells[(0.0,)].lack == Lack(not_made=1, failed=0, without=1)
    assert cells[(30.0,)].lack == Lack(not_made=1, failed=2, without=0)
    assert cells[(0.0,)].values == pytest.approx((0.21,))
    assert cells[(0.0,)].estimate.value == inf  # of one that has it and one that is larger than every number
    assert points.quantity(PASSED).cells[(0.0,)].lack == Lack(1, 0, 0)


def test_differences_are_of_runs_with_the_same_seed_and_all_else_equal(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, "controller=nboc, boc, bsmc", row=with_holes, change="profile=paper")
    points = load(store)
    found = points.differences(1, "formation_final_m")
    assert found.kind == "difference"
    assert found.dimensions[1].values == ("boc - nboc", "bsmc - nboc")
    cell = found.cells[(60.0, "boc - nboc")]
    assert cell.values == pytest.approx((0.1, 0.0))  # what neither run has is a tie
    assert cell.lack == Lack(not_made=1, failed=0, without=0)
    assert found.cells[(30.0, "bsmc - nboc")].lack == Lack(1, 2, 0)
    expected = Study(store).compare("controller", "nboc", "boc", "formation_final_m").difference
    pairs = [cell for key, cell in found.cells.items() if key[1] == "boc - nboc"]
    assert sum(cell.estimate.runs for cell in pairs) == expected.runs == 4


def test_a_sample_is_no_product_and_its_pairs_are_one_cell(tmp_path: Path) -> None:
    axes = ["network.links.*.loss=0 %..60 % latin 5", "network.links.*.delay=50 ms..1 s latin 5", CONTROLLER]
    points = load(made_up(tmp_path / "s", *axes, row=usual))
    assert not points.product
    (cell,) = points.differences(2, "formation_final_m").cells.values()
    assert len(cell.values) == 15
    assert load(made_up(tmp_path / "grid", LOSS, DELAY, row=usual)).product


def safe_and_not_always_live(values: Mapping[str, Any], seed: int) -> dict[str, Any]:
    live = seed > 1
    return {**usual(values, seed), "passed": live, "status": "pass" if live else "check_failed",
            "check.deaths": True, "check.tumbled": live}  # fmt: skip


def test_each_check_has_a_pass_rate_in_table_and_pictures(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, row=safe_and_not_always_live, seeds=4)
    points, (row, *_) = load(store, ["check.deaths", "check.tumbled"]), Study(store).summary("check.deaths")
    assert row.medians == {"check.deaths": pass_rate(4, 4)}
    assert row.passed == pass_rate(3, 4)
    deaths, tumbled = points.quantity("check.deaths"), points.quantity("check.tumbled")
    assert (deaths.kind, deaths.what) == ("share", "runs that passed deaths [%]")
    assert deaths.cells[(0.0,)].estimate == pass_rate(4, 4)
    assert tumbled.cells == points.quantity(PASSED).cells
    names = [picture.name for picture in draw(points)]
    assert names == ["passed", "check.deaths", "check.tumbled"]


def test_a_study_of_one_check_passes_where_that_check_does(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, row=safe_and_not_always_live, seeds=4)
    record = replace(store.record, spec=StudySpec("small", check="deaths", until="pass ±20 %"))
    judged = Store(store.directory, record)
    assert [row.passed for row in judged.rows()] == [True] * 12
    assert load(judged).quantity(PASSED).what == "runs that passed deaths [%]"
    assert all(row.passed == pass_rate(4, 4) for row in Study(judged).summary())
    write_record(store.directory, replace(record, spec=StudySpec("small", check="nosuch")))
    with pytest.raises(StudyError, match="damaged: it has no check nosuch"):
        Store.open(store.directory)


def test_unknown_measures_are_said(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", row=usual)
    with pytest.raises(StudyError, match='no measure "e_rms"; did you mean "e_rms_m"'):
        load(store, ["e_rms"])
    for name in ("passed", "reason", "seed"):
        with pytest.raises(StudyError, match=f'no measure "{name}"'):
            load(store, [name])


def test_a_damaged_study_is_said(tmp_path: Path) -> None:
    store = made_up(tmp_path / "s", LOSS, row=usual)

    def damaged(what: str, *statements: str) -> None:
        damage(store.directory, *statements)
        with pytest.raises(StudyError, match=f"is damaged: .*{what}"):
            load(Store.open(store.directory))

    axis = '"network.links.*.loss"'
    damaged("there twice", f"UPDATE points SET {axis} = 0.0 WHERE point = 1")
    damaged("is no number", f"UPDATE points SET {axis} = 9e999 WHERE point = 1")
    damaged("another type", f"UPDATE points SET {axis} = 'x' WHERE point = 1")
    damaged(
        "not numbered",
        f"UPDATE points SET {axis} = 30.0 WHERE point = 1",
        "UPDATE points SET point = 7 WHERE point = 2",
    )
    damaged("not its own", "DELETE FROM points WHERE point = 7")
    record = json.loads((store.directory / "study.json").read_text("utf-8"))
    record["checks"] *= 2
    (store.directory / "study.json").write_text(json.dumps(record), "utf-8")
    with pytest.raises(StudyError, match="two columns check"):
        load(Store.open(store.directory))
