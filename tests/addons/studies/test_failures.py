"""A folder of failures: a search that goes on fills it, whoever interrupts it, and its scenarios fail again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from small_scenario import small
from study_engine import Here, Rows

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.failures import INDEX, FailureFolder, FoundFailure, Regression, make_least
from fleet.addons.studies.modules import NO_MODULES
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.rare import RareEvent
from fleet.addons.studies.record import NAME, read_record
from fleet.addons.studies.search import SearchResult, search
from fleet.addons.studies.splitting import Splitting
from fleet.execution.whole_run import run, run_loaded
from fleet.scenario.loading import parse_scenario

NEMESIS = "nemesis={every: 400 ms, for: 300 ms, pick: [mute, deaf, {wrench: {vehicles: 1, force: 400 0 0 N}}]}"
CHECKS = (
    "checks={formation_error: {below: 4.6 m, after: 800 ms}, consensus_error: {below: 8 m, after: 800 ms}, "
    "tumbled: waived, signal: [{name: far, topic: error.formation_norm, above: 4 m, sometimes: true}, "
    "{name: never-there, topic: state.z, above: 99 m, sometimes: true}]}"
)


def searched(folder: Path, engine: Here | None = None, runs: int = 8) -> SearchResult:
    keep = FailureFolder(folder)
    return search(small(NEMESIS, CHECKS), engine or Here(), lambda runs: None, most_runs=runs, keep=keep)


class Interrupted(Here):
    """Ends after some runs, which come back in the wrong order."""

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        made = [next(tasks) for _ in range(5)]
        for k in (1, 0, 2, 4):
            super().make(iter([made[k]]), take, wait)
            if (task := next(tasks)).seed <= 5:  # a repeat
                super().make(iter([task]), take, wait)
        raise KeyboardInterrupt


def test_a_search_goes_on_after_a_failure_and_after_an_interruption(tmp_path: Path) -> None:
    seeds = {
        n: [v.check for v in run_loaded(small(NEMESIS, CHECKS, f"seed={n}")).checks if not v.passed]
        for n in range(1, 9)
    }
    kinds = {
        check: min(n for n in seeds if check in seeds[n]) for check in sorted({c for cs in seeds.values() for c in cs})
    }
    assert kinds and len([n for n in seeds if seeds[n]]) > 1
    whole = searched(tmp_path / "whole", Here(backwards=True))
    with pytest.raises(KeyboardInterrupt):
        searched(tmp_path / "again", Interrupted())
    again = Here()
    later = searched(tmp_path / "again", again)
    repeated = sorted({first for first in kinds.values() if first > 3})
    assert sorted(task.seed for task in again.tasks) == sorted([4, 5, 6, 7, 8, *repeated])  # 5 was behind 4
    for found in (whole, later):
        assert (found.runs, found.kinds, found.seed) == (8, kinds, min(kinds.values()))
        far, nowhere = found.reached
        assert (far.hits > 0, nowhere.runs, nowhere.hits, nowhere.seed) == (True, 8, 0, None)
    index = [(tmp_path / name / INDEX).read_text("utf-8").replace(name, "") for name in ("whole", "again")]
    assert index[0] == index[1]


def test_what_is_kept_is_the_least_that_fails_and_regress_compares_it(tmp_path: Path) -> None:
    searched(tmp_path)
    folder, scenario = FailureFolder(tmp_path), small(NEMESIS, CHECKS)
    done = make_least(folder, scenario, Here(), lambda doing, runs: None, NO_MODULES, 15)
    assert done and make_least(folder, scenario, Here(), lambda doing, runs: None, NO_MODULES, 15) == []
    for kept in folder.failures():
        result = run(tmp_path / kept.file, seed=kept.seed)
        assert kept.check in [v.check for v in result.checks if not v.passed] and kept.least
        assert result.digest == kept.digest
        assert (
            kept.paste
            == f"fleet run {tmp_path / kept.file} --seed {kept.seed}  # fails {kept.check}, sha256 {kept.digest[:16]}"
        )
    regression = Regression(folder)
    found = regression.run(Here(backwards=True), lambda runs: None, NO_MODULES)
    assert all(one.same and not one.differs for one in found)
    path = tmp_path / folder.failures()[0].file
    path.write_text(
        path.read_text("utf-8").replace("below: 4.6 m", "below: 99 m").replace("below: 8 m", "below: 99 m"), "utf-8"
    )
    mended = Regression(folder)
    found = mended.run(Here(), lambda runs: None, NO_MODULES)
    assert [one.same for one in found] == [False] + [True] * (len(found) - 1) and found[0].got == "passes"
    assert sum(one.accepted for one in mended.accept(found)) == 1 and folder.failures()[0].expected == "pass"
    assert all(one.same for one in Regression(folder).run(Here(), lambda runs: None, NO_MODULES))


def test_a_search_of_another_scenario_is_not_gone_on_with(tmp_path: Path) -> None:
    folder = FailureFolder(tmp_path)
    folder.save(small(NEMESIS, CHECKS), folder.tried(small(), "one"))
    with pytest.raises(StudyError, match="belongs to another small"):
        folder.tried(small(), "two")
    assert (
        msgspec.json.decode(msgspec.json.encode(FoundFailure(file="a.yaml", check="c", seed=1, digest="d")))["expected"]
        == "fail"
    )


@pytest.mark.parametrize("data", [b'{"text": "\xff"}', b"[" * 200_000, b'{"a":' * 200_000], ids=["text", "list", "map"])
def test_a_damaged_file_of_a_study_or_a_search_is_said_in_words(data: bytes, tmp_path: Path) -> None:
    """Of each of the four: not UTF-8, and deeper than anything that we write."""
    scenario = small(NEMESIS, CHECKS)
    for name in (NAME, INDEX, f"{scenario.name}.search.json", "rare.json"):
        (tmp_path / name).write_bytes(data)
    rare = RareEvent(scenario, "formation_error", Splitting())
    for read in (
        lambda: read_record(tmp_path),
        lambda: FailureFolder(tmp_path).failures(),
        lambda: FailureFolder(tmp_path).tried(scenario, "key"),
        lambda: rare.run(Here(), lambda doing, runs: None, 1, tmp_path / "rare.json"),
    ):
        with pytest.raises(StudyError, match=r"is damaged|cannot be read"):
            read()


def test_a_failure_of_programs_is_run_by_netem_and_has_no_digest(tmp_path: Path) -> None:
    text = "title: Two\nnodes: {a: {}, b: {}}\nprograms: {a: {run: 'true'}}\nduration: 1 s\n"
    found = FoundFailure(file="two-x.yaml", check="x", seed=3, digest="0123456789abcdef", from_seed=3)
    kept = FailureFolder(tmp_path).add(found, parse_scenario(text, "two.yaml"))
    assert kept.paste == f"fleet netem {tmp_path / 'two-x.yaml'} --seed 3  # fails x"
    assert kept.digest == ""
