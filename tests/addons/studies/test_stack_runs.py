"""Runs of stacks in studies: what most of three came to counts, late ones are made again, and a busy machine is spared.

No run is made here: each comes to what the test says.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import Mock

import pytest
import yaml
from study_engine import Here, Rows

from fleet.addons.studies import stack_runs
from fleet.addons.studies.engine import engine_of
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.failures import FailureFolder, FoundFailure, Regression, file_of
from fleet.addons.studies.modules import Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import Plan
from fleet.addons.studies.row import FAILED, LATE, CheckRow, Row, majority
from fleet.addons.studies.search import SearchResult, search
from fleet.addons.studies.shrink import Shrinker
from fleet.addons.studies.stack_runs import TRIES, StackRuns
from fleet.addons.studies.stopping import estimate
from fleet.addons.studies.store import Store
from fleet.addons.studies.summary import summarise
from fleet.addons.studies.sweep import prepare, run_study
from fleet.addons.studies.values import parse_axis
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy

STACKS = Modules(programs=True)
STACK = {
    "name": "stack", "title": "Three programs", "nodes": {"m1": {}, "m2": {}, "m3": {}}, "duration": "10 s",
    "programs": {"m*": {"run": "true"}}, "network": {"links": {"*": "loss 10%"}},
    "checks": {"programs": "running", "signal": {"name": "heard", "topic": "x", "above": 0}},
    "signals": {"x": {"line": "(?P<value>.*)"}},
}  # fmt: skip


def stack(**sections: Any) -> Scenario:
    return parse_scenario(yaml.safe_dump(STACK | sections, sort_keys=False), "stack.yaml", policy=Policy(stranger=""))


def row(seed: int = 1, *failed: str, status: str = "") -> Row:
    """A row that fails some checks, or has no result."""
    checks = {} if status else {name: CheckRow(name not in failed, 1.0) for name in ("programs", "heard")}
    what = status or ("check_failed" if failed else "pass")
    return Row(seed=seed, status=what, passed=None if status else not failed, checks=checks)


# --- votes


@pytest.mark.parametrize(
    ("rows", "check", "expected"),
    [
        (["", "", "heard"], "heard", ("", 1, 3)),
        (["", "heard", "heard"], "heard", ("heard", 2, 3)),
        (["heard", ""], "heard", ("", 1, 2)),
        (["heard", "late", "failed"], "heard", ("heard", 1, 1)),
        (["late", "failed"], "heard", ("late", 0, 0)),
        (["programs", "heard", "heard"], "heard", ("heard", 2, 3)),
        (["programs", "heard", ""], "", ("programs", 2, 3)),
        (["programs", "", ""], "heard", ("programs", 0, 3)),
    ],
)
def test_what_most_of_the_runs_with_a_verdict_came_to_counts(
    rows: list[str], check: str, expected: tuple[str, int, int]
) -> None:
    """A tie is no failure."""
    made = [row(1, *([one] if one in ("heard", "programs") else []), status=one if one in ("late", "failed") else "")
            for one in rows]  # fmt: skip
    most, failed, of = majority(made, check)
    assert ("".join(most.failed_checks) or (most.status if not most.has_result else ""), failed, of) == expected


class Votes(Here):
    """Says which checks fail of a seed, or of a scenario, the first time, the second time and so on."""

    def __init__(self, says: Callable[[Task, int], str]) -> None:
        super().__init__()
        self._says, self.times = says, Counter[str]()

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        for task in tasks:
            super().make(iter([task]), take, wait)

    def rows(self, task: Task) -> Rows:
        what = f"{task.seed} {task.text}"
        self.times[what] += 1
        said = self._says(task, self.times[what])
        made = row(task.seed, status=said) if said in (LATE, FAILED) else row(task.seed, *said.split())
        made.key, made.point = task.key, task.point
        return [made]


def searched(
    says: Callable[[int, int], str], keep: Path | None = None, runs: int = 6
) -> tuple[SearchResult, list[int]]:
    """The result of a search, and the seeds that were run."""
    engine = Votes(lambda task, time: says(task.seed, time))
    found = search(
        stack(nemesis={"mode": "swarm", "pick": ["partition"]}), engine, lambda runs: None, most_runs=runs,
        modules=STACKS, keep=keep and FailureFolder(keep),
    )  # fmt: skip
    return found, [task.seed for task in engine.tasks]


def test_a_seed_that_fails_is_repeated_three_times_and_most_of_the_four_count() -> None:
    """A failure that came once of four times is told as a run without result; one that came three times is found."""
    found, seeds = searched(lambda seed, time: "heard" if (seed, time) in ((2, 1), (4, 1), (4, 2), (4, 4)) else "")
    assert seeds == [1, 2, 2, 2, 2, 3, 4, 4, 4, 4]
    assert (found.seed, found.check, found.votes) == (4, "heard", {"heard": (3, 4)})
    assert (found.runs, found.without) == (3, 1)
    assert found.reason == "seed 2 failed heard in 1 of 4 runs, which is too seldom to look into"


def test_repetitions_that_are_late_have_no_vote() -> None:
    found, _ = searched(lambda seed, time: "heard" if time in (1, 3) else LATE)
    assert (found.seed, found.votes) == (1, {"heard": (2, 2)})


@pytest.mark.parametrize(("old", "new"), [("heard", "programs"), ("programs", "heard")])
def test_each_new_kind_of_failure_has_votes_of_its_own(old: str, new: str, tmp_path: Path) -> None:
    """A seed that fails a known check each time, and a new one once, has not found the new one."""
    found, seeds = searched(
        lambda seed, time: f"{old} {new}" if (seed, time) in ((2, 1), (3, 1), (3, 2), (3, 3)) else old, tmp_path
    )
    assert seeds == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 5, 6]
    assert found.kinds == {old: 1, new: 3}
    assert found.votes == {old: (4, 4), new: (3, 4)}
    kept = {one.check: one for one in FailureFolder(tmp_path).failures()}
    assert {check: one.seed for check, one in kept.items()} == {old: 1, new: 3}
    assert kept[old].paste == f"fleet netem {tmp_path / f'stack-{old}.yaml'} --seed 1  # fails {old}"


def test_two_new_kinds_of_one_seed_have_votes_of_their_own(tmp_path: Path) -> None:
    """One fails each time, and the other one only once."""
    found, _ = searched(lambda seed, time: "heard programs" if (seed, time) == (1, 1) else "heard", tmp_path, 1)
    assert (found.kinds, found.votes) == ({"heard": 1}, {"heard": (4, 4)})


def test_a_scenario_is_made_smaller_as_long_as_two_of_three_runs_fail() -> None:
    """Two of the same need no third one; nodes stay, since their programs know how many they are."""
    faults = [{"at": f"{n} s", "for": "2 s", "partition": f"m{n} / m{n % 3 + 1}"} for n in (1, 2, 3)]

    def says(task: Task, time: int) -> str:
        scenario = parse_scenario(task.text, task.name, policy=Policy(stranger=""))
        if "partition m2 / m3" not in [event.what for event in scenario.faults.events]:
            return "heard" if time == 1 else ""  # one of three, by chance
        return "" if time == 2 else "heard"

    engine = Votes(says)
    found = Shrinker(stack(faults=faults), engine, lambda doing, runs: None, STACKS).shrink("heard")
    assert [event.what for event in found.scenario.faults.events if event.action == "begins"] == ["partition m2 / m3"]
    assert found.scenario.nodes == ("m1", "m2", "m3")
    assert max(engine.times.values()) == 3
    same = Votes(lambda task, time: "heard")
    Shrinker(stack(faults=faults), same, lambda doing, runs: None, STACKS).shrink("heard")
    assert max(same.times.values()) == 2


@pytest.mark.parametrize(
    ("says", "got", "same", "broken"),
    [
        (["heard", "heard", "heard"], "fails heard in 3 of 3 runs", True, False),
        (["heard", "", "heard"], "fails heard in 2 of 3 runs", True, False),
        (["", "heard", ""], "passes in 2 of 3 runs", False, False),
        (["", "late", ""], "passes in 2 of 2 runs", False, False),
        (["late", "late", "late"], "no result: the host was late", False, True),
    ],
)
def test_a_kept_failure_is_repeated_three_times(
    says: list[str], got: str, same: bool, broken: bool, tmp_path: Path
) -> None:
    scenario, folder = stack(), FailureFolder(tmp_path)
    folder.add(FoundFailure(file=file_of(scenario, "heard"), check="heard", seed=1, digest=""), scenario)
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.chdir(tmp_path)
        regression = Regression(folder)
        engine = Votes(lambda task, time: says[time - 1])
        (found,) = regression.run(_late_words(engine), lambda runs: None, STACKS)
    assert (found.got, found.same, found.broken, found.differs) == (got, same, broken, False)
    assert len(engine.tasks) == 3


def _late_words(engine: Votes) -> Votes:
    made = engine.rows

    def rows(task: Task) -> Rows:
        (one,) = made(task)
        one.reason = "the host was late" if one.status == LATE else ""
        return [one]

    engine.rows = rows  # type: ignore[method-assign]
    return engine


# --- late runs, and how many go on at a time


class FakeRun:
    """A run that is over at once; `says` tells the status of the n-th run of a seed."""

    says: Callable[[int, int], str]
    cpu_share: float | None = 0.1
    idle_share = 9.0
    alive: ClassVar[set[FakeRun]] = set()
    most = 0

    def __init__(self, task: Task, tries: int) -> None:
        self.task, self.tries = task, tries
        self.over = True
        FakeRun.alive.add(self)
        FakeRun.most = max(FakeRun.most, len(FakeRun.alive))

    def row(self) -> Row:
        FakeRun.alive.discard(self)
        said = type(self).says(self.task.seed, self.tries)
        return row(self.task.seed, *said.split()) if said not in (LATE, FAILED) else row(self.task.seed, status=said)

    def end(self) -> None:
        FakeRun.alive.discard(self)


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> type[FakeRun]:
    monkeypatch.setattr(stack_runs, "_Run", FakeRun)
    monkeypatch.setattr(stack_runs, "POLL_S", 0.0)
    monkeypatch.setattr(stack_runs, "processors", lambda: 4)
    FakeRun.says, FakeRun.cpu_share, FakeRun.most = (lambda seed, tries: ""), 0.1, 0
    FakeRun.idle_share = 9.0
    FakeRun.alive.clear()
    return FakeRun


def tasks(count: int) -> Iterator[Task]:
    return (Task(f"key-{seed}", 0, seed, "stack", "text", inf, STACKS) for seed in range(1, count + 1))


def made(runs: StackRuns, count: int) -> list[Row]:
    rows: list[Row] = []
    runs.make(tasks(count), rows.extend, lambda: None)
    return sorted(rows, key=lambda one: one.seed)


def test_a_late_run_is_made_again_and_is_none_if_it_is_late_each_time(fake: type[FakeRun]) -> None:
    tried: list[tuple[int, int]] = []

    def says(seed: int, tries: int) -> str:
        tried.append((seed, tries))
        return LATE if seed == 2 or (seed == 3 and tries < 3) else "heard" if seed == 4 else ""

    fake.says = says  # type: ignore[assignment]
    rows = made(StackRuns(1), 4)
    assert [one.status for one in rows] == ["pass", LATE, "pass", "check_failed"]
    assert Counter(seed for seed, _ in tried) == {1: 1, 2: TRIES, 3: 3, 4: 1}
    assert [one.key for one in rows] == [f"key-{seed}" for seed in range(1, 5)]


@pytest.mark.parametrize(("share", "most"), [(0.1, 30), (1.0, 3), (5.0, 1), (0.0001, 32), (None, 1)])
def test_as_many_go_on_at_a_time_as_the_first_one_leaves_room_for(
    share: float | None, most: int, fake: type[FakeRun]
) -> None:
    """Three quarters of four processors; who says a number has that number."""
    fake.cpu_share = share
    assert len(made(StackRuns(), 80)) == 80
    assert fake.most == most
    fake.most = 0
    made(StackRuns(5), 80)
    assert fake.most == 5


def test_what_else_the_machine_does_has_room(fake: type[FakeRun]) -> None:
    """Other programs leave 1.1 of four processors to the first run, which takes 0.1; before, 30 went on at a time."""
    fake.cpu_share, fake.idle_share = 0.1, 1.1
    made(StackRuns(), 80)
    assert fake.most == 9


def test_the_idle_time_of_the_processors_grows_as_time_passes() -> None:
    before = stack_runs._idle_s()
    assert before > 0.0 and stack_runs._idle_s() >= before


def test_a_cluster_makes_no_runs_of_stacks() -> None:
    with pytest.raises(StudyError, match="this machine"):
        engine_of(STACKS, scheduler=Mock())


def test_fewer_go_on_at_a_time_if_more_than_a_fifth_is_late(fake: type[FakeRun]) -> None:
    """And the user is told; with one at a time there is nothing left to halve."""
    told: list[str] = []
    fake.says = lambda seed, tries: LATE if seed % 2 else ""  # type: ignore[assignment,misc]
    made(StackRuns(8, told.append), 12)
    assert told[0] == "3 of 5 runs were late, because this machine is too busy: 4 at a time from now on"
    assert [text.partition(": ")[2].split()[0] for text in told[:3]] == ["4", "2", "1"]
    assert told[3].endswith(": one goes on at a time already")
    told.clear()
    fake.says = lambda seed, tries: LATE if seed % 5 == 0 and tries == 1 else ""  # type: ignore[assignment,misc]
    made(StackRuns(1, told.append), 20)
    assert not told


def test_nobody_is_left_if_a_study_is_interrupted(fake: type[FakeRun]) -> None:
    def interrupts() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        StackRuns(3).make(tasks(9), lambda rows: None, interrupts)
    assert not fake.alive


class StackEngine(Here):
    """An engine whose runs of stacks are made up."""

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        StackRuns(2).make(tasks, take, wait)


def study(folder: Path, monkeypatch: pytest.MonkeyPatch, **how: Any) -> Store:
    monkeypatch.chdir(folder)
    (folder / "stack.yaml").write_text(yaml.safe_dump(STACK, sort_keys=False), "utf-8")
    plan = Plan("stack.yaml", (), (parse_axis("network.links.*.loss=0 %, 50 %"),), seeds=(1, 2, 3, 4))
    store, modules = prepare(plan, folder / "study", **how)
    assert modules.programs
    run_study(store, StackEngine(), lambda progress: None, modules=modules)
    return store


def test_late_runs_are_counted_and_are_in_no_share(
    fake: type[FakeRun], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither among those that passed, nor among those without a result."""
    fake.says = lambda seed, tries: {1: LATE, 2: "heard", 3: FAILED}.get(seed, "")  # type: ignore[assignment,misc]
    store = study(tmp_path, monkeypatch)
    for point in summarise(store):
        assert (point.runs, point.failed, point.late) == (4, 1, 1)
        assert (point.passed.runs, point.passed.value) == (2, 0.5)
    rows = [one for one in store.rows(details=True) if one.point == 0]
    assert [one.status for one in rows] == [LATE, "check_failed", FAILED, "pass"]
    assert estimate(rows).runs == 2
