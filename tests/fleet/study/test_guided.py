"""A guided search: the same for whoever makes the runs, with moves that fit, and a corpus of the best."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scenario import small
from study_engine import Here

from fleet.execution.judged import judged
from fleet.scenario.loading import parse_scenario
from fleet.study.errors import StudyError
from fleet.study.failures import FailureFolder
from fleet.study.guided import Corpus, GuidedSearch
from fleet.study.guided_memory import KnownRun
from fleet.study.moves import MOST_FAULTS, Draws, Mutator, end_of
from fleet.study.search import Searched
from fleet.study.shrink import tree_of

PICK = "mute, down, partition, {wrench: {vehicles: 1, force: 400 0 0 N}}"
NEMESIS = f"nemesis={{every: 400 ms, for: 300 ms, until: 1500 ms, pick: [{PICK}]}}"
CHECK = "checks={formation_error: {below: 4 m, after: 800 ms}, tumbled: waived}"


def guided(engine: Here, *overrides: str, most_runs: float = 20) -> Searched:
    return GuidedSearch(small(NEMESIS, CHECK, *overrides)).run(engine, lambda runs: None, most_runs)


def test_the_order_in_which_runs_end_changes_nothing() -> None:
    engines = Here(), Here(backwards=True)
    for engine in engines:
        found = guided(engine, "checks.formation_error.below=99 m")
        assert (found.seed, found.runs, found.most_failures) == (None, 20, None)  # they are no sample
    assert {task.key for task in engines[0].tasks} == {task.key for task in engines[1].tasks}
    assert len({task.text for task in engines[0].tasks}) > 5  # not only seeds


def test_what_fails_is_a_scenario_that_fails() -> None:
    found = guided(Here(), "checks.formation_error.below=4.6 m", most_runs=60)
    if found.scenario is None:
        pytest.fail("nothing was found")
    assert not judged(found.scenario).passed
    assert not judged(parse_scenario(found.scenario.to_yaml(), "again")).passed


def kept(folder: Path, engine: Here, most_runs: int = 20) -> Searched:
    errors = "formation_error: {below: 4.6 m, after: 800 ms}, consensus_error: {below: 8 m, after: 800 ms}"
    search = GuidedSearch(small(NEMESIS, f"checks={{{errors}, tumbled: waived}}"))
    return search.run(engine, lambda runs: None, most_runs, keep=FailureFolder(folder))


def contents(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text("utf-8").replace(folder.name, "") for file in folder.glob("*[nl]")}


def test_with_a_folder_it_goes_on_after_a_failure_and_after_an_interruption(tmp_path: Path) -> None:
    """An interruption, another budget and the order in which runs end change nothing."""
    whole, again = Here(backwards=True), [Here(most=5), Here(most=6), Here()]
    found = kept(tmp_path / "whole", whole)
    assert (found.runs, set(found.kinds)) == (20, {"formation_error", "consensus_error"})
    for engine in again[:2]:
        with pytest.raises(KeyboardInterrupt):
            kept(tmp_path / "again", engine)
    assert kept(tmp_path / "again", again[2], 13).runs == 13
    last = Here()
    later = kept(tmp_path / "again", last)
    assert (later.runs, later.kinds, later.seed, later.check) == (found.runs, found.kinds, found.seed, found.check)
    made = [task.key for engine in [*again, last] for task in engine.tasks]
    assert len(made) == 22  # none twice but those that failed in a new way
    assert set(made) == {task.key for task in whole.tasks}
    assert contents(tmp_path / "again") == contents(tmp_path / "whole")
    assert later.scenario is not None and not judged(later.scenario).passed
    assert kept(tmp_path / "again", nothing := Here()).runs == 20 and nothing.tasks == []


def test_what_is_known_may_come_from_anybody(tmp_path: Path) -> None:
    kept(tmp_path, Here(), 10)
    file = tmp_path / "small.guide.msgpack"
    known = msgspec.msgpack.decode(file.read_bytes())
    for change, words in (
        ({"key": "other"}, "belongs to another search"),
        ({"format": 2}, "has format 2, expected 1"),
        ({"number": "x"}, "is damaged"),
        ({"novel": [[{"vehicles": 3}, [], {}]]}, "is damaged"),
        ({"fresh": [[{"explode": "1"}]]}, "is damaged"),
        ({"first": ["no scenario", 1, "formation_error"]}, "is damaged"),
    ):
        file.write_bytes(msgspec.msgpack.encode(known | change))
        with pytest.raises(StudyError, match=words):
            kept(tmp_path, Here())


def test_it_needs_a_nemesis() -> None:
    with pytest.raises(StudyError, match="--nemesis adds some"):
        GuidedSearch(small(CHECK))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_moves_make_scenarios(seed: int, of: int) -> None:
    scenarios = [small(NEMESIS, CHECK, f"seed={n}") for n in (1, 2, 3, 4)]
    trees = [tree_of(scenario) for scenario in scenarios]
    latest = 1_500_000_000
    mutator = Mutator(scenarios[0], latest)
    faults = mutator.mutated(trees[of]["faults"], [tree["faults"] for tree in trees], 900_000_000, Draws(1, seed))
    assert len(faults) <= MOST_FAULTS
    assert all(end_of(fault, scenarios[0].duration_ns) <= latest for fault in faults)
    parse_scenario(json.dumps({**trees[of], "faults": faults}), "moved")
    again = mutator.mutated(trees[of]["faults"], [tree["faults"] for tree in trees], 900_000_000, Draws(1, seed))
    assert again == faults


def test_the_corpus_keeps_what_is_near_and_what_is_new() -> None:
    corpus = Corpus(None)
    for n in range(20):
        corpus.take(KnownRun({"n": n}, [], {"near": (20.0 - n, 1.0), "same": (0.0, None)}), [n // 10])
    assert [tried.tree["n"] for tried in corpus.nearest["near"]] == list(range(19, 9, -1))
    assert [tried.tree["n"] for tried in corpus.novel] == [0, 10]
    chosen = {corpus.choose(Draws(1, key))[0].tree["n"] for key in range(50)}
    assert chosen <= {0, *range(10, 20)} and len(chosen) > 3  # a check whose margin is always the same guides nobody
