"""A study from plan to rows: checked first, interrupted, gone on with, and the same whoever made it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from math import inf, isnan
from pathlib import Path
from shutil import copytree
from unittest.mock import Mock

import pytest
from failing_laws import failing
from made_up_study import damage
from pandas.testing import assert_frame_equal
from small_scenario import SMALL
from small_scenario import small_file as small_file
from study_engine import Here

from fleet.addons.studies import store as stores
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.plan import Plan, plan_of
from fleet.addons.studies.record import StudyRecord
from fleet.addons.studies.spec import StudySpec
from fleet.addons.studies.store import Store
from fleet.addons.studies.study import Study, open_study
from fleet.addons.studies.summary import summarise
from fleet.addons.studies.sweep import Progress, load_points, measure_columns, modules_again, prepare, run_study
from fleet.addons.studies.values import parse_axis
from fleet.errors import ScenarioError
from fleet.execution.whole_run import run
from fleet.logs.open_log import open_log
from fleet.scenario.text.overrides import NET, SET, Override
from world.plugins.trust import trusting

CHECKS = Override(SET, "checks={formation_error: {below: 0.9 m, after: 0.9 s}}")
LINKS = Override(SET, "network.links={'*': delay 50ms loss 10%}")


def plan(file: str, *axes: str, seeds: tuple[int, ...] = (1, 2)) -> Plan:
    chosen = axes or ("network.links.*.loss=0 %, 80 %", "neighbours.extrapolate=hold, neighbour")
    return Plan(file, (CHECKS, LINKS), tuple(map(parse_axis, chosen)), seeds=seeds)


def made(file: str, directory: Path, engine: Here | None = None) -> Store:
    store, _ = prepare(plan(file), directory)
    run_study(store, engine or Here(), lambda progress: None)
    return store


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """The study of eight runs, made once. Nobody may write to its directory."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "small.yaml").write_text(SMALL, "utf-8")
    return made(str(folder / "small.yaml"), folder / "study")


def assert_same_rows(one: Store, other: Store) -> None:
    """Every value but the wall time is the same, to the last bit."""
    frames = [store.frame().drop(columns=["wall_s"]) for store in (one, other)]
    assert_frame_equal(*frames, check_exact=True)


def test_a_row_is_the_run(small_file: str, whole: Store) -> None:
    frame = open_study(whole.directory).to_pandas()
    assert len(frame) == 8
    row = frame[(frame["network.links.*.loss"] == 80.0) & (frame["seed"] == 2)].iloc[1]
    assert row["neighbours.extrapolate"] == "neighbour"
    changes = [CHECKS.text, LINKS.text, "network.links.*.loss=80 %", "neighbours.extrapolate=neighbour"]
    found = run(small_file, set=changes, seed=2)
    assert row["digest"] == found.digest
    assert row["passed"] == found.passed
    assert row["check.formation_error"] == found.checks[0].passed
    assert row["value.formation_error"] == found.checks[0].value
    assert row["formation_final_m"] == found.values["formation"]["worst_m"]
    assert isnan(row["settle_5cm_s"])
    assert frame.attrs["units"]["network.links.*.loss"] == "%"
    assert frame.attrs["units"]["age_p95_s"] == "s"


def test_every_seed_draws_faults_of_its_own(small_file: str, tmp_path: Path) -> None:
    """They were drawn once, and all seeds had the same."""
    changes = {"nemesis": {"every": "300 ms", "for": "200 ms", "pick": ["deaf", "mute", "pause"]}}
    change = Override(SET, f"nemesis={json.dumps(changes['nemesis'])}")
    store, _ = prepare(Plan(small_file, (change,), seeds=(1, 2, 3)), tmp_path / "study")
    run_study(store, Here(), lambda progress: None)
    digests = [run(small_file, set=changes, seed=seed).digest for seed in (1, 2, 3)]
    assert list(store.frame()["digest"]) == digests


def test_rows_are_the_same_in_whatever_order_they_were_made(small_file: str, whole: Store, tmp_path: Path) -> None:
    assert_same_rows(whole, made(small_file, tmp_path / "b", Here(backwards=True)))


def test_an_interrupted_study_goes_on_where_it_was(small_file: str, whole: Store, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file), tmp_path / "study")
    first, second = Here(most=3), Here()
    with pytest.raises(KeyboardInterrupt):
        run_study(store, first, lambda progress: None)
    again = Store.open(tmp_path / "study")
    assert again.missing == 5
    assert [(task.point, task.seed) for task in first.tasks] == [(0, 1), (1, 1), (2, 1)]  # all points before seed 2
    seen: list[tuple[int, int]] = []

    def on_progress(progress: Progress) -> None:
        seen.append((progress.made, progress.runs))

    run_study(again, second, on_progress)
    assert len(second.tasks) == 5
    assert {task.key for task in first.tasks}.isdisjoint(task.key for task in second.tasks)
    assert seen[-1] == (8, 8)
    assert again.missing == 0
    assert_same_rows(again, whole)


def test_a_study_is_run_by_one_program_at_a_time(small_file: str, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file), tmp_path / "study")
    again = Store.open(tmp_path / "study")
    with store.lock(), pytest.raises(StudyError, match="another fleet runs the study"), again.lock():
        pass
    with again.lock():
        pass


def test_rows_of_another_program_are_kept(small_file: str, tmp_path: Path) -> None:
    """One opens the study while another one runs it, and goes on when that one was interrupted."""
    first, _ = prepare(plan(small_file), tmp_path / "study")
    second = Store.open(tmp_path / "study")
    with pytest.raises(KeyboardInterrupt):
        run_study(first, Here(most=3), lambda progress: None)
    run_study(second, Here(), lambda progress: None)
    assert (second.missing, len(second.finished_runs())) == (0, 8)


def test_a_run_without_a_frame_is_a_row(small_file: str, tmp_path: Path) -> None:
    """As when a law fails at the first tick."""
    Path("bad_law.py").write_text(failing(0, "raise RuntimeError('no')"), "utf-8")
    Path("bad.yaml").write_text(f"{SMALL}controller: bad_law:Law\n", "utf-8")
    bad = Plan("bad.yaml", (CHECKS,), (parse_axis("duration=1 s, 2 s"),))
    store, modules = prepare(bad, tmp_path / "study")
    progress = run_study(store, Here(), lambda progress: None, modules=modules)
    assert progress.new == 2
    (row, _) = store.rows(["wall_s"], details=True)
    assert row.status == "broken"
    assert "no" in row.reason
    assert row.number("wall_s") > 0
    with trusting(True):
        assert modules_again(store).fingerprints == modules.fingerprints


def test_a_strangers_study_cannot_fill_the_memory(whole: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "_MOST_CELLS", 100)
    with pytest.raises(StudyError, match="has 8 rows, too many to be read at once"):
        Study(whole).to_pandas()


def test_a_round_in_which_no_run_is_made_is_the_last(small_file: str, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file), tmp_path / "study")
    store.record.seeds[:] = [1, 1]
    with pytest.raises(StudyError, match="is damaged: runs that were made are missing"):
        run_study(store, Here(), lambda progress: None)


def test_the_log_of_a_run_that_comes_out_differently_is_not_kept_and_others_are(whole: Store, tmp_path: Path) -> None:
    store = Store.open(copytree(whole.directory, tmp_path / "study"))
    damage(store.directory, "UPDATE runs SET digest = '0000' WHERE point = 0 AND seed = 1")
    progress = run_study(store, Here(), lambda progress: None, logs="all")
    (sentence,) = progress.not_kept
    assert sentence.startswith("the log of point 0 with seed 1 is not kept: it came out differently")
    assert len(list((store.directory / "logs").iterdir())) == 7
    assert not store.log_of(0, 1).exists()


def test_the_study_keeps_where_its_scenario_is(small_file: str, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file), tmp_path / "study", spec=StudySpec(small_file))
    assert store.record.spec == StudySpec(str(tmp_path / small_file))


def test_every_mistake_of_every_point_is_told_before_anything_is_made(small_file: str, tmp_path: Path) -> None:
    wrong = plan(small_file, "network.links.*.loss=0 %, 130 %", "duration=1 s, 2 m, 3 s")
    with pytest.raises(ScenarioError) as caught:
        prepare(wrong, tmp_path / "study")
    text = str(caught.value)
    assert "between 0% and 100%" in text
    assert "(in 3 of 6 points, first network.links.*.loss=130 %, duration=1 s)" in text
    assert "(in 2 of 6 points, first network.links.*.loss=0 %, duration=2 m)" in text
    assert not (tmp_path / "study").exists()


def test_a_run_that_fails_is_a_row(small_file: str, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file, "network.links.*.loss=0 %, 80 %", seeds=(1,)), tmp_path / "study")
    progress = run_study(store, Here(), lambda progress: None, timeout_s=0.0)
    assert (progress.failed, progress.passed) == (2, 0)
    rows = list(store.rows(details=True))
    assert {(row.status, row.reason) for row in rows} == {("failed", "took longer than 0 s")}
    (summary, _) = summarise(store)
    assert (summary.runs, summary.failed, summary.passed.runs) == (1, 1, 0)


def test_measures_of_signals_are_columns(small_file: str, tmp_path: Path) -> None:
    spec = StudySpec(small_file, measures=["p95  |error.e|", "separation_min_m"])
    wanted = Plan(small_file, (CHECKS, LINKS), (parse_axis("duration=1 s, 2 s"),))
    store, _ = prepare(wanted, tmp_path / "study", spec=spec)
    run_study(store, Here(), lambda progress: None)
    study = open_study(store.directory)
    frame = study.to_pandas()
    assert frame.attrs["units"]["p95 |error.e|"] == frame.attrs["units"]["separation_min_m"] == "m"
    assert (frame["p95 |error.e|"] > frame["e_final_m"]).all()
    assert frame["separation_min_m"].between(2.0, 6.0).all()
    assert list(study.summary()[0].medians) == ["p95 |error.e|", "separation_min_m"]
    assert list(study.summary("p95 |error.e|")[0].medians) == ["p95 |error.e|"]
    with pytest.raises(StudyError, match=r'no signal error\.e_nrm; did you mean "error.e_norm"'):
        prepare(wanted, tmp_path / "other", spec=StudySpec(small_file, measures=["max error.e_nrm"]))
    assert not (tmp_path / "other").exists()


UNTIL = StudySpec("small.yaml", until="separation_min_m ±12 %", most_seeds=20)


def adding(file: str, directory: Path) -> Store:
    wanted = Plan(file, (LINKS,), (parse_axis("initial.scatter=1 cm, 1 m"),), seeds=(1, 2, 3, 4), most_seeds=20)
    return prepare(wanted, directory, spec=UNTIL)[0]


def test_seeds_are_added_until_the_interval_is_narrow(small_file: str, tmp_path: Path) -> None:
    store = adding(small_file, tmp_path / "study")
    progress = run_study(store, Here(backwards=True), lambda progress: None)
    known, spread = (store.frame().query(f"point == {n}")["seed"].tolist() for n in (0, 1))
    assert known == [1, 2, 3, 4, 5, 6]  # fewer have no interval
    assert spread == list(range(1, len(spread) + 1))
    assert len(spread) in (6, 9, 13, 19, 20)
    assert (progress.made, progress.runs) == (6 + len(spread), 6 + len(spread))
    assert (store.missing, store.short()) == (0, 0)

    again = adding(small_file, tmp_path / "again")  # interrupted in the second round, and gone on with
    with pytest.raises(KeyboardInterrupt):
        run_study(again, Here(most=5), lambda progress: None)
    assert again.missing == 3
    with pytest.raises(KeyboardInterrupt):
        run_study(again, Here(most=1), lambda progress: None)
    opened = Store.open(again.directory)
    run_study(opened, Here(), lambda progress: None)
    assert_same_rows(opened, store)


def test_a_point_that_may_have_no_more_seeds_is_told(small_file: str, tmp_path: Path) -> None:
    spec = StudySpec(small_file, until="pass ±1 %", most_seeds=3)
    store, _ = prepare(Plan(small_file, (CHECKS,), seeds=(1, 2)), tmp_path / "study", spec=spec)
    run_study(store, Here(), lambda progress: None)
    assert (len(store.finished_runs()), store.missing, store.short()) == (3, 0, 1)


def test_no_run_begins_after_the_budget(small_file: str, tmp_path: Path) -> None:
    store, _ = prepare(plan(small_file), tmp_path / "study")
    progress = run_study(store, Here(), lambda progress: None, budget_s=0.0)
    assert (progress.made, progress.runs, store.missing) == (1, 8, 7)
    assert run_study(store, Here(), lambda progress: None).made == 8


def test_the_logs_of_runs_that_failed_are_kept(small_file: str, tmp_path: Path) -> None:
    asked = plan(small_file, "checks.formation_error.below=0.1 m, 90 m")
    asked = replace(asked, changes=(*asked.changes, Override(SET, "checks.tumbled=waived")))
    store, _ = prepare(asked, tmp_path / "study", spec=StudySpec(small_file, keep_logs="failed"))
    run_study(store, Here(), lambda progress: None)
    assert {path.name for path in (store.directory / "logs").iterdir()} == {"point-0-seed-1", "point-0-seed-2"}
    for row in list(store.rows(details=True))[:2]:
        directory = store.log_of(0, row.seed)
        log = open_log(directory)
        assert (log.run["seed"], log.missing) == (str(row.seed), "")
        assert json.loads((directory / "result.json").read_text("utf-8"))["digest"] == row.digest
    there = Here()
    run_study(store, there, lambda progress: None)
    assert there.tasks == []
    run_study(store, there, lambda progress: None, logs="all")
    assert len(there.tasks) == 2
    assert len(list((store.directory / "logs").iterdir())) == 4


def test_the_summary_has_intervals(whole: Store) -> None:
    study = Study(whole)
    rows = study.summary("formation_final_m")
    assert [row.values for row in rows][:2] == [
        {"network.links.*.loss": 0.0, "neighbours.extrapolate": "hold"},
        {"network.links.*.loss": 0.0, "neighbours.extrapolate": "neighbour"},
    ]
    assert all(row.runs == 2 and row.passed.low < row.passed.high for row in rows)
    never = study.summary("settle_5cm_s")[0].medians["settle_5cm_s"]  # larger than every number, and not left out
    assert (never.value, never.runs) == (inf, 2)
    with pytest.raises(StudyError, match='no measure "formation"; did you mean'):
        study.summary("formation")


def test_two_values_are_compared_run_by_run(whole: Store) -> None:
    study = Study(whole)
    found = study.compare("network.links.*.loss", 0.0, 80.0, "loss_share")
    assert found.difference.runs == 4  # two seeds at each of two extrapolations
    assert found.difference.value > 0.5
    assert found.better == 0.0
    assert (
        study.compare("neighbours.extrapolate", "hold", "neighbour", "packets_lost").better == 0.5
    )  # the same network
    assert study.compare("network.links.*.loss", 0.0, 80.0, "settle_5cm_s").better == 0.5  # never, in both
    for key, value, measure in (("speed", 1.0, "passed"), ("network.links.*.loss", 1.0, "passed"), ("seed", 1, "x")):
        with pytest.raises(StudyError, match=r"is not varied|has no value"):
            study.compare(key, value, 80.0, measure)


def test_arrays_have_the_keys_as_dimensions_and_units(whole: Store) -> None:
    found = Study(whole).to_xarray()
    assert dict(found.sizes) == {"network.links.*.loss": 2, "neighbours.extrapolate": 2, "seed": 2}
    assert found["age_p95_s"].attrs["units"] == "s"
    assert found["network.links.*.loss"].attrs["units"] == "%"
    lossy = found["loss_share"].sel({"network.links.*.loss": 80.0})
    assert float(lossy.mean()) > float(found["loss_share"].sel({"network.links.*.loss": 0.0}).mean())


def test_a_run_is_made_again_with_its_log(whole: Store, tmp_path: Path) -> None:
    study = Study(whole)
    row = study.to_pandas().iloc[3]
    found = study.rerun(int(row["point"]), int(row["seed"]), tmp_path / "runs")
    assert found.digest == row["digest"]
    assert (found.directory / "run.mcap").exists()
    values = {"network.links.*.loss": 80.0, "neighbours.extrapolate": "hold"}
    assert study.rerun(values, 1, tmp_path / "runs").values["seed"] == 1
    with pytest.raises(StudyError, match="0 to 3"):
        study.rerun(4, 1)
    with pytest.raises(StudyError, match="2 points have"):
        study.rerun({"network.links.*.loss": 80.0}, 1)


def test_a_folder_that_has_a_study_and_one_that_has_none(small_file: str, whole: Store, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="is there already: choose"):
        prepare(plan(small_file), whole.directory)
    with pytest.raises(StudyError, match="it has no study"):
        open_study(tmp_path)


def test_two_studies_that_are_made_in_one_place_at_once_are_two(
    small_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is whole, whoever comes second gets the next place, and the names of both are on the disk."""
    places, others, synced = [tmp_path / "study", tmp_path / "study-2"], list[Store](), list[list[bool]]()
    write, sync = stores.write_record, stores.sync_folder

    def meanwhile(part: Path, record: StudyRecord) -> None:
        monkeypatch.setattr(stores, "write_record", write)
        others.append(prepare(plan(small_file), places)[0])
        write(part, record)

    def noted(folder: Path) -> None:
        synced.append([place.exists() for place in places])
        sync(folder)

    monkeypatch.setattr(stores, "write_record", meanwhile)
    monkeypatch.setattr(stores, "sync_folder", noted)
    store, _ = prepare(plan(small_file), places)
    assert [others[0].directory, store.directory] == places
    assert all(len(Store.open(place).points) == 4 for place in places)
    assert synced == [[True, False], [True, True]]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.yaml", "study", "study-2"]


@pytest.mark.parametrize("umask", [0o002, 0o022, 0o077])
def test_all_files_of_a_study_have_the_rights_that_the_umask_leaves(
    umask: int, small_file: str, tmp_path: Path
) -> None:
    before = os.umask(umask)
    try:
        store, _ = prepare(plan(small_file), tmp_path / "study")
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in store.directory.iterdir()}
    assert modes == dict.fromkeys(["study.json", "study.sqlite"], 0o666 & ~umask)


def test_a_study_that_is_ended_while_it_is_made_leaves_nothing(
    small_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder without study.json had been left, where the study could not be made again."""
    ended = Mock(side_effect=KeyboardInterrupt)
    with monkeypatch.context() as patched:
        patched.setattr("fleet.addons.studies.store.write_record", ended)
        with pytest.raises(KeyboardInterrupt):
            made(small_file, tmp_path / "study")
    assert not (tmp_path / "study").exists()
    assert prepare(plan(small_file), tmp_path / "study")[0].record.seeds


def test_a_mistake_in_the_file_is_reported_once_whatever_values_are_like_its_words(tmp_path: Path) -> None:
    """Neither a value in the name of the file nor one that the message has beside others makes two of it."""
    file = tmp_path / "bad1.yaml"
    file.write_text("vehicles: 3\nnetwork: {period: 15 ms}\n", "utf-8")
    with pytest.raises(ScenarioError) as caught:
        load_points(Plan(str(file), (Override(NET, "* loss {loss}%"),), (parse_axis("loss=0, 1, 10, 15"),)))
    said = [problem.message for problem in caught.value.problems]
    assert len(said) == len(set(said)) and not any("points" in message for message in said)
    assert "network.period: 15 ms is not a whole number of ticks of 10 ms" in said


def test_moored_vehicles_have_no_formation_error_in_the_table() -> None:
    """It was 0 in every row, since they stay where they are."""
    changes = {"moored": "true", "agent": "fleet.protocols.average:ExactAverage", "checks": "{}"}
    scenarios = load_points(plan_of(StudySpec("average", set=changes)))
    assert measure_columns(StudySpec("average"), scenarios)[0] == ("age_p95_s", "loss_share")
