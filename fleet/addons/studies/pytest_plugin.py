"""A pytest plugin: the fixture `fleet_runs` runs a scenario with many seeds, in this process.

pytest loads it with every test run of an environment that has uuv-fleet, so it imports nothing but pytest until the
fixture is used. `docs/guide/regress.md` is its guide.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

if TYPE_CHECKING:
    from fleet.result.result import Result
    from fleet.scenario.scenario import Scenario

FleetRuns = Callable[..., "list[Result]"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the fixture."""
    group = parser.getgroup("uuv-fleet")
    group.addoption("--fleet-seeds", type=int, default=None, metavar="N",
                    help="how many seeds each fleet_runs tries, in place of what the test says")  # fmt: skip
    group.addoption("--fleet-keep", default="fleet-failures", metavar="DIR",
                    help="where logs of runs that failed go (default: fleet-failures)")  # fmt: skip


@pytest.fixture
def fleet_runs(request: pytest.FixtureRequest) -> FleetRuns:
    """A function that runs a scenario with many seeds and fails the test at the first seed that fails a check."""
    folder = Path(request.config.getoption("--fleet-keep"))
    most = request.config.getoption("--fleet-seeds")
    test = re.sub(r"[^A-Za-z0-9_.-]+", "-", request.node.name)[:100]

    def run(
        scenario: str | Path,
        seeds: int | Iterable[int] = 10,
        *,
        set: Mapping[str, Any] | Iterable[str] = (),
        net: Iterable[str] = (),
        fault: Iterable[str] = (),
        trust: bool = False,
    ) -> list[Result]:
        """Run a scenario with each seed in turn.

        Args:
            scenario: a shipped name, or a file. If the file is in the folder of the test, its name is enough.
            seeds: how many, from 1 on, or a list of them.
            set: changes to the scenario, as for `fleet.run`.
            net: conditions of links, as `["1->2 loss 30%"]`.
            fault: further faults, as `["at 10 s for 5 s down 1<->2"]`.
            trust: run modules, too, that are neither installed nor in the current directory.

        Returns:
            The results; all of them passed. A mistake in the scenario, or no such file, fails the test in words.
        """
        beside = request.path.parent / scenario
        name = str(scenario if Path(scenario).exists() or not beside.is_file() else beside)
        chosen = range(1, 1 + (most or seeds)) if isinstance(seeds, int) else list(seeds)[:most]
        return _run(_Asked(name, set, tuple(net), tuple(fault), trust), list(chosen), folder / test)

    return run


class _Asked(NamedTuple):
    """A scenario with changes, as a test asks for it."""

    name: str
    set: Any
    net: tuple[str, ...]
    fault: tuple[str, ...]
    trust: bool

    def load(self, seed: int) -> Scenario:
        """The scenario with a seed. Raises ScenarioError."""
        from fleet.execution.stepped_run import load_for
        from fleet.execution.whole_run import run

        return load_for(run, self.name, self.set, self.net, self.fault, seed, self.trust)

    @property
    def options(self) -> str:
        """The changes as options of `fleet run`."""
        from shlex import quote

        from fleet.execution.stepped_run import override_texts

        given = {"--set": override_texts(self.set), "--net": self.net, "--fault": self.fault}
        return "".join(f" {option} {quote(text)}" for option, texts in given.items() for text in texts)


def _run(asked: _Asked, seeds: list[int], directory: Path) -> list[Result]:
    from fleet.addons.studies.row import Reached
    from fleet.errors import FleetError

    name = asked.name
    found: list[Result] = []
    reached: dict[str, Reached] = {}
    for seed in seeds:
        mistake = ""
        try:
            result, log = _once(asked, seed)
        except FleetError as error:
            mistake = str(error)
        if mistake:  # outside, or pytest would show the error twice
            pytest.fail(mistake, pytrace=False)
        if not result.passed:
            log = log or _keep_run(asked, seed, directory.with_name(f"{directory.name}-seed-{seed}"))
            pytest.fail(_words(asked, result, len(seeds), log), pytrace=False)
        found.append(result)
        for verdict in result.checks:
            if verdict.reached is not None:
                one = reached.setdefault(verdict.check, Reached(verdict.check))
                one.note(seed, reached=verdict.reached)
    if missed := [one.words for one in reached.values() if not one.hits]:
        pytest.fail(f"{name}: no run fails, and that says little: {'; '.join(missed)}", pytrace=False)
    return found


def _once(asked: _Asked, seed: int) -> tuple[Result, str]:
    """Make one run. Returns its result, and where its log is if there is one already."""
    from fleet.addons.studies.stack_runs import run_stack
    from fleet.execution.external_agents import uses_wall_clock
    from fleet.execution.whole_run import run
    from fleet.scenario.programs import admit_programs
    from world.plugins.trust import trusting

    scenario = asked.load(seed)
    with trusting(asked.trust):
        admit_programs(scenario.spec, scenario.reading.policy)
    if not uses_wall_clock(scenario):
        return run(scenario, trust=asked.trust), ""
    result = run_stack(scenario, Path("runs"))
    return result, f"its log: {result.directory} (fleet view {result.directory})"


def _keep_run(asked: _Asked, seed: int, directory: Path) -> str:
    """Make a run once more, with its directory; returns where that is, or why there is none."""
    from fleet.addons.studies.one_run import run_and_record

    try:
        run_and_record(asked.load(seed), directory)
    except OSError as error:
        return f"its log is not kept: {error}"
    return f"its log: {directory} (fleet view {directory})"


def _words(asked: _Asked, result: Result, of: int, log: str) -> str:
    from shlex import quote

    from fleet.addons.studies.stack_runs import describe_failure

    failed = [one for one in result.checks if not one.passed]
    names = ", ".join(one.check for one in failed) or str(result.status)
    lines = [
        f"{asked.name} fails {names} with seed {result.seed}, of {of} seeds",
        *([result.reason] if result.reason else []),
    ]
    lines += [f"  {one.check}: {one.asked}; found {one.words}" for one in failed]
    if result.directory is not None:  # of programs on the wall clock, which has no digest that comes again
        return "\n".join([lines[0], *describe_failure(result.directory), log])
    return "\n".join(
        [
            *lines,
            f"fleet run {quote(asked.name)} --seed {result.seed}{asked.options}  # sha256 {result.digest[:16]}",
            log,
        ]
    )
