"""The first seed that fails is found, whoever makes the runs, and what no failure at all means is said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from math import inf
from typing import Any

import pytest
from small_scenario import small
from study_engine import Here, Rows

from fleet.addons.studies.bare_run import bare_verdicts
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import CheckRow, Covered, Row
from fleet.addons.studies.search import SearchResult, nemesis_of, search
from fleet.addons.studies.statistics import most_failures
from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.episodes import chance

NEMESIS = "nemesis={every: 400 ms, for: 300 ms, pick: [mute, deaf, {wrench: {vehicles: 1, force: 400 0 0 N}}]}"
CHECK = "checks={formation_error: {below: 4.6 m, after: 800 ms}, tumbled: waived}"


def searched(*overrides: str, engine: Here | None = None, **options: Any) -> SearchResult:
    return search(small(*overrides), engine or Here(), lambda runs: None, **({"most_runs": 12} | options))


def test_it_is_the_first_seed_that_fails_in_whatever_order_they_are_run() -> None:
    fails = [seed for seed in range(1, 5) if not run_loaded(small(NEMESIS, CHECK, f"seed={seed}")).passed]
    assert fails[0] > 1 and len(fails) > 1
    for engine in (Here(), Here(backwards=True)):
        found = searched(NEMESIS, CHECK, engine=engine)
        assert (found.seed, found.check, found.most_failures) == (fails[0], "formation_error", None)
    assert found.scenario == small(NEMESIS, CHECK, f"seed={fails[0]}")
    later = searched(NEMESIS, CHECK, f"seed={fails[0] + 1}")
    assert (later.first_seed, later.seed) == (fails[0] + 1, fails[1])


def test_losses_differ_by_seed_without_any_fault() -> None:
    """Such a scenario was refused: all its seeds were said to have the same."""
    lossy, aged = "network.links={'*': loss 60%}", "checks={max_age: {below: 290 ms}, tumbled: waived}"
    fails = [seed for seed in range(1, 13) if not run_loaded(small(lossy, aged, f"seed={seed}")).passed]
    assert searched(lossy, aged).seed == (fails[0] if fails else None)
    assert fails
    with pytest.raises(StudyError, match="draws nothing at random"):
        searched(aged, "initial={scatter: 0 m, around: reference}", "faults=[]")


class OneByOne(Here):
    """Asks for a run when the one before it is made, as workers do."""

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        for task in tasks:
            super().make(iter([task]), take, wait)


def test_no_run_is_begun_after_one_that_fails() -> None:
    engine = OneByOne()
    found = searched(NEMESIS, CHECK, engine=engine)
    assert [task.seed for task in engine.tasks] == [*range(1, (found.seed or 0) + 1), found.seed]  # it is repeated
    assert found.runs == len(engine.tasks) - 1


class OnceWrong(OneByOne):
    """Reports a failure of one seed that is none, the first time."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._wrong = [seed]

    def rows(self, task: Task) -> Rows:
        rows = super().rows(task)
        if task.seed in self._wrong:
            self._wrong.clear()
            rows[0].checks["formation_error"] = CheckRow(False)
        return rows


def test_a_failure_that_does_not_come_again_is_none() -> None:
    """Whatever made it: a search reports what its reader can repeat, and says what it could not repeat."""
    sound, engine = "checks={formation_error: {below: 99 m, after: 0 s}, tumbled: waived, deaths: waived}", OnceWrong(4)
    found = searched(NEMESIS, sound, engine=engine)
    assert [task.seed for task in engine.tasks] == [1, 2, 3, 4, 4, *range(5, 13)]
    assert (found.runs, found.without) == (11, 1)
    assert (found.seed, found.kinds) == (None, {})
    said = "not reproduced: the run with seed 4 failed formation_error, and failed none when it was repeated"
    assert found.reason.startswith(f"{said}. ")  # the log of the run that failed is not known


def test_none_that_fails_is_an_upper_bound() -> None:
    found = searched(NEMESIS, "checks={formation_error: {below: 99 m, after: 0 s}, tumbled: waived, deaths: waived}")
    assert (found.seed, found.runs, found.scenario) == (None, 12, None)
    assert found.most_failures == pytest.approx(1 - 0.05 ** (1 / 12))
    assert most_failures(200) == pytest.approx(0.0149, abs=1e-4)
    assert searched(NEMESIS, most_runs=inf, budget_s=-1.0).most_failures is None


def test_a_run_without_result_is_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("enough")

    monkeypatch.setattr("fleet.addons.studies.one_run.run_loaded", broken)
    found = searched(NEMESIS)
    assert (found.runs, found.without, found.reason, found.most_failures) == (0, 12, "RuntimeError: enough", None)


class Tumbles(OneByOne):
    """Whose runs are not judged by one check, and fail another with seed 3."""

    def rows(self, task: Task) -> Rows:
        checks = {"formation_error": CheckRow(None), "tumbled": CheckRow(task.seed != 3, 1.0)}
        return [Row(seed=task.seed, status="check_failed", passed=False, checks=checks)]


def test_only_checks_that_the_scenario_states_are_looked_for() -> None:
    """A check that could not be judged is no failure, either."""
    stated = [NEMESIS, "checks={formation_error: {below: 4.6 m}}"]
    found = searched(*stated, engine=Tumbles(), most_runs=6)
    assert (found.seed, found.runs, found.unstated) == (None, 6, {"tumbled": 3})
    for overrides, check in (([*stated, "checks.tumbled.at_most=0"], None), (stated, "tumbled"), ([NEMESIS], None)):
        assert searched(*overrides, engine=Tumbles(), most_runs=6, check=check).seed == 3


def test_a_nemesis_is_added_where_there_is_none() -> None:
    plain = small("duration=20 s")
    added = small("duration=20 s", nemesis_of(plain).text)
    assert added.undrawn.nemesis is not None
    events = added.faults.events
    assert events and max(event.tick for event in events) <= 0.75 * added.ticks


EPISODES = """
title: episodes
moored: true
vehicles: 3
duration: 14 s
graph: {shape: complete}
agent: {law: "fleet.protocols.election:Election", parameters: {vehicles: 3, lease_s: 2, quorum: fleet}}
network: {period: 100 ms, links: {"*": delay 100ms}}
nemesis: {mode: episodes, pick: [partition, pause], watch: [control.leads above 0]}
checks:
  signal: {name: always-1, topic: control.leader, vehicles: 2-3, within: [0, 1]}
"""


def test_a_search_with_episodes_says_what_began_faults_and_what_was_covered() -> None:
    """The scenario that it found has ordinary faults, so it fails again by itself."""
    scenario = parse_scenario(EPISODES, "e.yaml")
    found = search(scenario, Here(), lambda runs: None, most_runs=8)
    assert (found.check, found.triggered != {}) == ("always-1", True)
    assert found.scenario is not None and found.scenario.spec.triggers == []
    began = {fault.id for fault in found.scenario.spec.faults} & set(found.triggered)
    assert began and all("after control.leads above 0" in found.triggered[name] for name in began)
    again = run_loaded(found.scenario)
    assert [verdict.check for verdict in again.checks if verdict.failed] == ["always-1"]
    covered = found.covered
    assert covered is not None and (covered.episodes, covered.unit_s) == (found.runs, 2.0)
    assert covered.two == chance(2, 3, covered.episodes) > covered.three == chance(3, 3, covered.episodes)

    assert sum(covered.kinds.values()) == covered.episodes
    assert set(covered.faults) == {"partition", "pause"}


def test_what_was_drawn_is_said_of_episodes_alone_and_the_chance_of_a_pattern_where_there_are_partitions() -> None:
    def covered(change: str) -> Covered | None:
        text = EPISODES.replace(", watch: [control.leads above 0]", "")
        return search(parse_scenario(text, "e.yaml", [change]), Here(), lambda runs: None, most_runs=2).covered

    assert covered("nemesis={mode: swarm, watch: null}") is None
    pauses = covered("nemesis.pick=[pause]")
    assert pauses is not None and (pauses.two, pauses.three) == (None, None)
    assert pauses.kinds == {"mixed": 2} and set(pauses.faults) == {"pause"}


@pytest.mark.parametrize("moored", [False, True])
def test_a_run_that_fails_is_made_with_its_digest_and_confirmed_once(
    moored: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The confirmation makes the digest; both were made three times."""
    made: list[tuple[int, str]] = []

    def counted(how: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def run(scenario: Scenario, *arguments: Any, **options: Any) -> Any:
            made.append((scenario.seed, how))
            return make(scenario, *arguments, **options)

        return run

    monkeypatch.setattr("fleet.addons.studies.one_run.bare_verdicts", counted("bare", bare_verdicts))
    monkeypatch.setattr("fleet.addons.studies.one_run.run_loaded", counted("judged", run_loaded))
    scenario = parse_scenario(EPISODES, "e.yaml") if moored else small(NEMESIS, CHECK)
    found = search(scenario, Here(), lambda runs: None, most_runs=8)
    assert [how for seed, how in made if seed == found.seed] == ["bare" if moored else "judged", "judged"]
    assert all(runs == 1 for runs in Counter(seed for seed, _ in made if seed < (found.seed or 0)).values())
