"""The command `fleet search`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from fleet.cli import junit as cli_junit
from fleet.cli.completion import scenarios
from fleet.cli.documents.output import print_document
from fleet.cli.junit import JUNIT
from fleet.cli.shrink import MOST_RUNS, pieces, place_of, show_least, write_least
from fleet.cli.study_options import Making, changing_options, least_options, making_options
from fleet.cli.types import BUDGET, FOLDER
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override
    from fleet.study.engine import Engine
    from fleet.study.failures import FoundFailure
    from fleet.study.modules import Modules
    from fleet.study.search import Searched
    from fleet.study.shrink import Shrunk


NemesisMode = Literal["swarm", "liveness"] | None


@click.command()
@click.argument("scenario", shell_complete=scenarios)
@click.option("--budget", metavar="RUNS|TIME", type=BUDGET, default="200", show_default=True,
              help="The number of seeds to try, or the time in which new ones begin, e.g. '10 min'.")  # fmt: skip
@click.option("--nemesis", is_flag=True, help="Add a nemesis to a scenario without one: a swarm of faults.")
@click.option("--liveness", is_flag=True,
              help="Like --nemesis, but in the middle of the run a core of vehicles is healed; the others stay "
                   "broken.")  # fmt: skip
@click.option("--check", metavar="NAME", help="The check that must fail; by default any.")
@changing_options
@least_options
@click.option("--keep", metavar="DIR", type=FOLDER,
              help="Continue after a failure; keep the smallest scenario of each kind of failure in DIR.")  # fmt: skip
@JUNIT
@making_options()
def search(
    scenario: str,
    budget: tuple[float, float],
    nemesis: bool,
    liveness: bool,
    check: str | None,
    changes: list[str | Override],
    out: Path | None,
    force: bool,
    keep: Path | None,
    junit: Path | None,
    how: Making,
) -> None:
    """Try seeds of a nemesis until a check fails, and make that run as small as possible.

    The first seed is that of the scenario; --set seed=201 goes on after 200. Any number of workers finds the same seed:
    the first one that fails. The exit status is 1 if a check failed, as with fleet run, and 0 if none did in the whole
    budget. With --keep the search uses the whole budget, and the same command goes on with a greater one; fleet regress
    DIR repeats the failures that it kept.

    \b
    Examples:
      fleet search nemesis --budget 200
      fleet search election --nemesis --budget '10 min'
      fleet search election --liveness
      fleet search my.yaml --set seed=201 --check formation_error
      fleet search election --nemesis --budget 1000 --keep failures
    """
    from fleet.study.errors import StudyError

    if keep is not None and (out is not None or force):
        said = "--keep writes a file for each kind of failure"
        raise click.UsageError(f"{said}, so it cannot be used together with --out or --force")
    mode: NemesisMode = "liveness" if liveness else "swarm" if nemesis else None
    tried, modules = _tried(scenario, changes, mode)
    hunt = _Hunt(tried, check, keep, keep or place_of(tried, out, force=force))
    with how.showing(pieces) as tell, how.engine() as engine:
        try:
            hunt.run(engine, tell, engine.carry(modules), budget)
        except KeyboardInterrupt:
            say(hunt.stopped(scenario), err=True)
            raise
    found = hunt.found
    again = f"fleet run {scenario} --seed {found.seed}"
    cli_junit.write(junit, found.name, cli_junit.of_search(found, hunt.kept, again))
    _print(found, hunt.least, check, hunt.path, hunt.kept, as_json=how.as_json)
    if found.scenario is not None:
        sys.exit(1)
    if not found.runs:
        raise StudyError("no run came to its end, so nothing is known")


class _Hunt:
    """A search, and the least scenarios of what it found."""

    def __init__(self, tried: Scenario, check: str | None, keep: Path | None, path: Path) -> None:
        """Prepare it; `path`: of the least scenario, or of the folder that keeps several."""
        from fleet.study.failures import FailureFolder, FoundFailure
        from fleet.study.search import Searched

        self._tried, self._check, self.path = tried, check, path
        self._folder = None if keep is None else FailureFolder(keep)
        self.found = Searched(tried.name, tried.seed)
        self.least: Shrunk | None = None
        self.kept = list[FoundFailure]()

    def stopped(self, scenario: str) -> str:
        """What an interruption leaves, and how to go on; `scenario`: its name or file."""
        if self._folder is not None:
            return f"stopped; the same command goes on with what {self.path} has"
        if self.found.scenario is not None:
            return f"stopped before the failing run was made smaller, so {self.path} is not written"
        return f"stopped, and no check had failed; fleet search {scenario} --keep DIR can be stopped and goes on later"

    def run(
        self, engine: Engine, tell: Callable[[str, int], None], modules: Modules, budget: tuple[float, float]
    ) -> None:
        """Search, and make what was found as small as it can be."""
        from fleet.study.failures import make_least
        from fleet.study.search import search

        most_runs, budget_s = budget
        found = search(self._tried, engine, partial(tell, "seeds"), check=self._check, most_runs=most_runs,
                       budget_s=budget_s, modules=modules, keep=self._folder)  # fmt: skip
        self.found = found
        if found.without:
            say(f"{found.without} runs have no result, the first one because of: {found.reason}", err=True)
        if self._folder is not None:
            make_least(self._folder, self._tried, engine, tell, modules, MOST_RUNS)
            self.kept = self._folder.of(self._tried)
        elif found.scenario is not None:
            self._shrink(found, found.scenario, engine, tell, modules)

    def _shrink(
        self, found: Searched, failing: Scenario, engine: Engine, tell: Callable[[str, int], None], modules: Modules
    ) -> None:
        from fleet.study.shrink import Shrinker

        say(f"seed {found.seed} fails {found.check}, the first one from {found.first_seed} on", err=True)
        self.least = Shrinker(failing, engine, tell, modules).shrink(found.check, MOST_RUNS)
        write_least(self.least.scenario, self.path)


def _tried(name: str, changes: list[str | Override], mode: NemesisMode) -> tuple[Scenario, Modules]:
    """The scenario of the search, and the modules that its runs need; `mode`: of the nemesis that the scenario gets."""
    from fleet.scenario.loading import load_scenario
    from fleet.study.modules import modules_of
    from fleet.study.search import nemesis_of
    from fleet.study.study_file import refuse_study

    refuse_study(name)
    tried = load_scenario(name, changes)
    if mode is not None:
        tried = load_scenario(name, [*changes, nemesis_of(tried, mode)])
    return tried, modules_of([tried], Path(name).parent if Path(name).exists() else None)


def _print(
    found: Searched, least: Shrunk | None, check: str | None, path: Path, kept: list[FoundFailure], *, as_json: bool
) -> None:
    if as_json:
        from fleet.cli.documents.studies import first_failing

        print_document(first_failing(found, least, path, kept))
    elif found.scenario is not None and least is not None:
        show_least(found.scenario, least, path)
    elif found.scenario is not None:
        say(f"{found.runs} runs, kinds of failure: {len(found.kinds)}")
        for failure in kept:
            since = f"first with seed {failure.from_seed}; " if failure.from_seed is not None else ""
            say(f"{failure.check}: {since}{failure.found}")
            click.echo(failure.paste)  # whole, however narrow the terminal is
        click.echo(path)
    elif found.runs and found.most_failures is None:
        missed = "; ".join(one.words for one in found.reached if not one.hits)
        say(f"no failure found, but the runs did not get everywhere: {missed}")
    elif found.most_failures is not None:
        which = f"the check {check}" if check else "a check"
        say(f"none of {found.runs} runs fails {which}: at most {100 * found.most_failures:.2g} % of such runs do, "
            "with 95 % confidence")  # fmt: skip
    if not as_json:
        for one in found.reached:
            if one.hits:
                say(one.words)


COMMANDS = (search,)
