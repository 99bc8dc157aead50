"""A study of a border: the same rows in whatever order and however often interrupted, and what it says of them."""

from __future__ import annotations

import re
from math import inf, isnan
from pathlib import Path
from random import Random
from typing import Any

import pytest
from msgspec import structs
from pandas.testing import assert_frame_equal
from small_scenario import small_file as small_file
from study_engine import Drawn, Here

import fleet
from fleet.addons.studies.borders import Borders, find_borders, parse_along, prepare_borders, theory
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.pictures.points import MADE, NOT_MADE, load
from fleet.addons.studies.plan import Plan
from fleet.addons.studies.record import BorderRecord
from fleet.addons.studies.row import CheckRow, Row
from fleet.addons.studies.spec import BoundarySpec
from fleet.addons.studies.store import Store
from fleet.addons.studies.study import Study
from fleet.addons.studies.sweep import run_study
from fleet.addons.studies.values import parse_axis
from fleet.execution.whole_run import run
from fleet.scenario.text.overrides import NET, SET, Override

LINKS = Override(NET, "* delay {delay} loss {loss}")


pytestmark = pytest.mark.usefixtures("small_file")


def prepared(name: str, seeds: int = 40, along: str = "loss=0 %..95 %") -> Borders:
    axes = (parse_axis("delay=100 ms, 200 ms"), parse_along(along, 0.1))
    plan = Plan("small.yaml", (LINKS,), axes, seeds=tuple(range(1, seeds + 1)))
    store, _ = prepare_borders(plan, BoundarySpec(), Path(name))
    return Borders(store)


def loss_of(text: str) -> float:
    found = re.search(r"loss ([\d.]+)\s?%", text)
    return float(found[1]) if found else 0.0


def breaks_at_40(text: str, seed: int) -> bool:
    """Each seed has its own threshold; with 200 ms of delay all are 30 % lower."""
    return loss_of(text) < Random(seed).gauss(40.0 if "delay 100" in text else 10.0, 4.0)


def quiet(*_: Any, **__: Any) -> None:
    pass


def found(name: str, engine: Here, **how: Any) -> Borders:
    borders = prepared(name, **how)
    find_borders(borders, engine, quiet)
    return borders


def test_borders_are_found_with_few_runs() -> None:
    borders = found("a", Drawn(breaks_at_40), seeds=60)
    first, second = borders.estimates()
    assert first.values == {"delay": 100.0}
    assert first.low < 40.0 < first.high
    assert second.low < 10.0 < second.high
    assert first.where == second.where == "within"
    assert first.high - first.low <= 9.5
    assert first.runs <= 40  # of 60
    assert not borders.open()
    assert {row.seed for row in borders.rows()[0].values()} == set(range(1, first.runs + 1))  # each seed once


class Live(Drawn):
    """Every run fails its checks; one of them, `deaths`, only behind the border."""

    def rows(self, task: Task) -> list[Row]:
        (row,) = super().rows(task)
        return [structs.replace(row, passed=False, status="check_failed", checks={"deaths": CheckRow(row.passed)})]


def test_the_border_of_one_check_is_that_of_its_own_pass_rate() -> None:
    axes = (parse_along("loss=0 %..95 %", 0.1),)
    plan = Plan("small.yaml", (Override(NET, "* delay 100 ms loss {loss}"),), axes, seeds=tuple(range(1, 41)))
    store, _ = prepare_borders(plan, BoundarySpec(check="deaths"), Path("live"))
    find_borders(Borders(store), Live(breaks_at_40), quiet)
    (border,) = Borders(Store.open(store.directory)).estimates()
    assert border.low < 40.0 < border.high
    assert "the pass rate of deaths falls" in Borders(store).title
    with pytest.raises(StudyError, match='no check "death"; did you mean "deaths"'):
        prepare_borders(plan, BoundarySpec(check="death"), Path("none"))


def test_rows_do_not_depend_on_order_and_interruptions() -> None:
    whole = found("a", Drawn(breaks_at_40)).store
    borders = prepared("b")
    with pytest.raises(KeyboardInterrupt):
        find_borders(borders, Drawn(breaks_at_40, backwards=True, most=21), quiet)
    assert len(borders.store.finished_runs()) == 21
    rest = Drawn(breaks_at_40, backwards=True)
    find_borders(Borders(borders.store), rest, quiet)
    assert_frame_equal(whole.frame(), borders.store.frame(), check_exact=True)
    assert len(rest.tasks) == len(whole.finished_runs()) - 21  # nothing is made twice


def test_a_border_outside_says_so_with_the_bound_that_can_be_claimed() -> None:
    above, below = found("a", Drawn(lambda text, _: "delay 100" in text)).estimates()
    assert (above.where, above.value, above.low, above.high) == ("above", inf, inf, inf)
    assert (below.where, below.value, below.low, below.high) == ("below", -inf, -inf, -inf)
    assert above.runs == below.runs == 8
    assert above.last.runs == below.first.runs == 5
    assert above.last.value == 1.0 and 0.5 < above.last.low < 0.6  # Wilson, five of five
    assert below.first.value == 0.0


def test_what_rises_is_told() -> None:
    first, _ = found("a", Drawn(lambda text, seed: loss_of(text) > 50.0 or seed > 999)).estimates()
    assert first.rising[0] <= 50.0 < first.rising[1]


def test_runs_without_a_result_use_their_seeds() -> None:
    first, _ = found("a", Drawn(lambda *_: None), seeds=6).estimates()
    assert (first.runs, first.failed, first.where) == (0, 6, "open")
    assert isnan(first.first.value)


def test_equal_ratios_are_equally_far_apart() -> None:
    def breaks(text: str, seed: int) -> bool:
        delay = re.search(r"delay ([\d.]+)\s?(ms|s)", text)
        assert delay
        return float(delay[1]) * (1000.0 if delay[2] == "s" else 1.0) < Random(seed).gauss(100.0, 5.0)

    axes = (parse_along("delay=10 ms..1000 ms log 41", 0.1),)
    plan = Plan("small.yaml", (Override(NET, "* delay {delay}"),), axes, seeds=tuple(range(1, 41)))
    store, _ = prepare_borders(plan, BoundarySpec(), Path("a"))
    borders = Borders(store)
    find_borders(borders, Drawn(breaks), quiet)
    (only,) = borders.estimates()
    assert 70.0 < only.low < 100.0 < only.high < 140.0
    assert only.high / only.low < 1.6  # a tenth of two decades


def test_a_row_is_a_run() -> None:
    changes = Override(SET, "checks={formation_error: {below: 0.9 m, after: 0.9 s}}")
    plan = Plan(
        "small.yaml", (LINKS, changes), (parse_axis("delay=50 ms"), parse_along("loss=0 %, 80 %", 0.1)), seeds=(3, 4)
    )
    store, _ = prepare_borders(plan, BoundarySpec(), Path("a"))
    find_borders(Borders(store), Here(), quiet)
    rows = store.frame()
    assert [*zip(rows["loss"], rows["seed"], strict=True)] == [(0.0, 3), (80.0, 4)]
    direct = run("small.yaml", set=[changes.text, "network.links={'*': delay 50ms loss 80%}"], seed=4)
    assert rows["digest"][1] == direct.digest
    assert rows["passed"][1] == direct.passed


@pytest.mark.parametrize(
    ("text", "width", "count", "second"),
    [
        ("loss=0 %..95 %", 0.1, 20, "5 %"),
        ("delay=0..2 s", 0.1, 21, "0.1 s"),
        ("delay=0..2 s", 0.02, 101, "0.02 s"),
        ("k=0..0.01371", 0.1, 16, "0.000914"),  # no round step meets the end
    ],
)
def test_a_range_gets_steps_that_are_narrow_enough(text: str, width: float, count: int, second: str) -> None:
    values = parse_along(text, width).values
    assert len(values) == count
    assert values[1].text == second


def test_a_sweep_is_no_study_of_a_border_and_the_other_way_round() -> None:
    borders = prepared("a")
    with pytest.raises(StudyError, match="To continue it: fleet boundary a"):
        run_study(borders.store, Here(), quiet)
    borders.store.record.border = None
    with pytest.raises(StudyError, match="To continue it: fleet sweep a"):
        Borders(borders.store)


def test_values_beyond_a_limit_are_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    store = prepared("a").store
    monkeypatch.setattr("fleet.addons.studies.borders.MOST_PLACES", 19)
    with pytest.raises(StudyError, match="a is damaged"):
        Borders(store)


def test_what_no_border_needs_is_not_missing() -> None:
    store = found("a", Drawn(breaks_at_40)).store
    state = load(store).state
    assert Study(store).missing == 0
    assert (state == NOT_MADE).sum() == 0
    assert (state == MADE).sum() == len(store.finished_runs())


@pytest.mark.parametrize("record", [BorderRecord(level=7.0, log=False), BorderRecord(log=True)])
def test_a_damaged_study_is_said(record: BorderRecord) -> None:
    store = prepared("a").store
    store.record.border = record  # a level beyond 1; equal ratios from 0 on
    with pytest.raises(StudyError, match="a is damaged"):
        Borders(store)


def test_scripts_have_borders_rows_and_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    from contextlib import nullcontext

    monkeypatch.setattr("fleet.addons.studies.study.engine_of", lambda *_: nullcontext(Drawn(breaks_at_40)))
    made = fleet.boundary("small.yaml", "loss=0 %..95 %", {"delay": ["100 ms", "200 ms"]}, net=[LINKS.text], out="a")
    assert [round(border.value, -1) for border in made.borders] == [40.0, 10.0]
    assert set(made.study.to_pandas()["delay"]) == {100.0, 200.0}
    assert made.write_picture() == Path("a/border.png")


def test_the_rules_of_fleet_check_and_the_age_under_loss(tmp_path: Path) -> None:
    axes = (
        parse_axis("neighbours.extrapolate=neighbour, hold"),
        parse_axis("delay=0 s, 200 ms, 1 s"),
        parse_along("loss=0 %..100 %/4 %", 0.1),
    )
    plan = Plan("paper", (Override(NET, "* delay {delay} loss {loss}"),), axes)
    store, _ = prepare_borders(plan, BoundarySpec(), tmp_path / "study")
    found = theory(Borders(store))
    assert [one.shunting for one in found] == [(pytest.approx(8.13, abs=0.01), 10.0)] * 6
    assert [one.stable for one in found[:3]] == [True, True, False]  # it bears 0.25 s
    # K tau rho(A) = 2 x tau x 1.447 is 1 at tau = 0.3456 s, which is the delay and 0.1 s / (1 - p), less a tick.
    assert [one.reckoning for one in found] == [18, 9, 0, None, None, None]
