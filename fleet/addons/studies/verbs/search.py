"""The commands that look for failures and make them small: search, shrink, regress, rare."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
from functools import partial
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import click

from fleet.addons.studies.verbs import junit_cases
from fleet.addons.studies.verbs.study_options import LeastFile, WorkerOptions
from fleet.cli import junit as cli_junit
from fleet.cli.changes import Changes
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document, print_result
from fleet.cli.junit import Junit
from fleet.cli.types import BUDGET, FILE, FOLDER, TIME, Force, Whole
from fleet.errors import printable
from fleet.option import Option
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.studies.engine_interface import Engine
    from fleet.addons.studies.failures import FoundFailure, RegressionResult
    from fleet.addons.studies.modules import Modules
    from fleet.addons.studies.rare import RareFound
    from fleet.addons.studies.search import SearchResult
    from fleet.addons.studies.shrink import Shrunk
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override

MOST_RUNS = 2000
SEEDS_TO_TRY = 200.0, inf  # by default, and however long that takes
MOST_FAULTS = 4  # that a line names
SEEDS = "seeds"  # what a search makes first


@command(document="fleet.addons.studies.verbs.documents.ShrunkScenario")
def shrink(
    failing: Annotated[str, scenarios, Option("", "LOG|SCENARIO")],
    *,
    changes: Changes,
    check: Annotated[str | None, Option(
        "The check that must still fail; by default the first that fails.", "NAME")] = None,
    out: LeastFile = None,
    force: Force = False,
    budget: Annotated[int, Whole(1), Option("Stop after this number of runs.", "RUNS")] = MOST_RUNS,
    how: WorkerOptions,
) -> None:  # fmt: skip
    """Make a run that fails a check as small as possible.

    The command removes faults and vehicles, shortens the run and its faults, and makes faults milder, as long as the
    check still fails. From a log it takes all faults, including injected ones. It writes the smallest scenario to a
    file.

    \b
    Examples:
      fleet shrink runs/latest
      fleet shrink nemesis --set seed=4 --check tumbled
      fleet shrink my.yaml --out least.yaml
    """
    from fleet.addons.studies.modules import modules_of
    from fleet.addons.studies.shrink import Shrinker

    scenario, folder = _failing_scenario(failing, changes)
    path = place_of(scenario, out, force=force)
    modules = modules_of([scenario], folder)
    with how.showing(pieces) as on_progress, how.engine(modules) as engine:
        try:
            found = Shrinker(scenario, engine, on_progress, engine.carry(modules)).shrink(check, budget)
        except KeyboardInterrupt:
            say(f"stopped, so {path} is not written; --budget N ends with the least scenario after N runs", err=True)
            raise
    write_least(found.scenario, path)
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import shrink_document

        print_document(shrink_document(found, scenario, path))
    else:
        show_least(scenario, found, path)


def place_of(scenario: Scenario, out: Path | None, *, force: bool) -> Path:
    """Where the least scenario goes. Raises StudyError: it cannot be written."""
    from fleet.addons.studies.errors import StudyError

    path = out or Path(f"{scenario.name}-least.yaml")
    if not path.parent.is_dir():
        raise StudyError(f"{path} cannot be written: there is no folder {path.parent}")
    try:
        there = path.exists()
        if there and not force:
            raise StudyError(f"{path} is there already: choose another file with --out, or --force")
        path.open("a").close()  # now, rather than after all runs
        if not there:
            path.unlink()
    except OSError as error:
        raise StudyError(f"{path} cannot be written: {error.strerror}; choose another file with --out") from None
    return path


def write_least(scenario: Scenario, path: Path) -> None:
    """Write the least scenario. Raises StudyError: it cannot be written; then it is printed on stderr."""
    from fleet.addons.studies.errors import StudyError
    from fleet.scenario.loading import short_text
    from netem.whole_file import write_whole

    text = short_text(scenario)
    try:
        write_whole(path, text.encode(), 0o666)
    except OSError as error:
        click.echo(text, err=True)
        raise StudyError(f"{path} cannot be written: {error.strerror}; the least scenario stands above") from None


def pieces(line: StatusLine, doing: str, runs: int) -> list[Piece]:
    """The current trial, and the number of runs made."""
    return [Piece(0, [f"{runs} runs"]), Piece(1, [doing])]


def _seed_pieces(budget: tuple[float, float]) -> Callable[[StatusLine, str, int], list[Piece]]:
    """What shows a search: how many of its seeds were tried, and how long the rest will take. `budget`: the most seeds,
    and the most seconds; one of them is inf.
    """
    most, most_s = budget
    begun = time.monotonic()

    def shown(line: StatusLine, doing: str, runs: int) -> list[Piece]:
        if doing != SEEDS:
            return pieces(line, doing, runs)
        took_s = time.monotonic() - begun
        left_s = most_s - took_s if most == inf else took_s * (most - runs) / runs if runs else inf
        left = "" if left_s == inf else f"at most {timedelta(seconds=round(max(0.0, left_s)))} left"
        made = f"{runs} seeds" if most == inf else f"{runs} of {most:g} seeds"
        return [Piece(0, [made]), Piece(2, [left, ""]), Piece(1, [f"{runs / took_s:.2g} seeds/s" if runs else "", ""])]

    return shown


def show_least(
    scenario: Scenario, found: Shrunk, path: Path, triggered: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Say what was made less, and where the least scenario is. `triggered`: what began faults, by their ids."""
    verb = "netem" if scenario.nodes else "run"
    say(f"{_enough(found.scenario, triggered)}. Then {found.check} fails. See why: fleet {verb} {path}; fleet why")
    for step in found.steps or ["nothing can be left out"]:
        say(f"  {step}")
    first, last = found.found
    say(f"  {found.check} fails with {last}, and in {scenario.name} with {first}; {found.runs} runs")
    click.echo(path)


def _enough(scenario: Scenario, triggered: Mapping[str, str]) -> str:
    """The faults that are enough for a failure, in words."""
    from fleet.scenario.scenario import timeline

    end_s, faults = scenario.duration_ns / 1e9, timeline(scenario)
    each = [
        f"{one.what} "
        + (f"from {one.begin:g} s" if one.end >= end_s else f"for {one.end - one.begin:g} s from {one.begin:g} s")
        + (f" ({triggered[one.id]})" if one.id in triggered else "")
        for one in faults[:MOST_FAULTS]
    ]
    more = [f"{len(faults) - len(each)} more"] if len(faults) > len(each) else []
    count = f"{'One fault is' if len(faults) == 1 else f'{len(faults)} faults are'} enough"
    return f"{count}: {', '.join(each + more)}" if faults else "No fault is needed"


def _failing_scenario(name: str, changes: Iterable[str | Override]) -> tuple[Scenario, Path | None]:
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.scenario.loading import load_scenario

    path = Path(name)
    if name in shipped_scenarios() or path.suffix in (".yaml", ".yml"):
        return load_scenario(name, [*changes]), path.parent if path.exists() else None
    from fleet.repeat.recorded_run import read_recorded_run
    from fleet.scenario.trust import Policy

    return read_recorded_run(path).script([*changes], Policy()), None


NemesisMode = Literal["swarm", "episodes", "liveness"] | None


@command(document="fleet.addons.studies.verbs.documents.FirstFailing")
def search(
    scenario: Annotated[str, scenarios],
    *,
    budget: Annotated[tuple[float, float], BUDGET, Option(
        "The number of seeds to try, or the time in which new ones begin, e.g. '10 min'. With --all the most runs; by "
        "default then 20000.")] = SEEDS_TO_TRY,
    whole: Annotated[str, Option(
        "In place of seeds: every set of so many faults of some kinds, begins and lengths.", "SPACE", "--all")] = "",
    nemesis: Annotated[bool, Option("Add a nemesis to a scenario without one: a swarm of faults.")] = False,
    episodes: Annotated[bool, Option(
        "Like --nemesis, but a few faults at a time, in the protocol's own unit, and then a quiet time.")] = False,
    liveness: Annotated[bool, Option(
        "Like --nemesis, but in the middle of the run a core of vehicles is healed; the others stay broken.")] = False,
    check: Annotated[str | None, Option(
        "The check that must fail; by default any that the scenario states.", "NAME")] = None,
    changes: Changes,
    out: LeastFile = None,
    force: Force = False,
    keep: Annotated[Path | None, FOLDER, Option(
        "Continue after a failure; keep the smallest scenario of each kind of failure in DIR.")] = None,
    junit: Junit = None,
    how: WorkerOptions,
) -> None:  # fmt: skip
    """Try seeds of a nemesis until a check fails, and make that run as small as possible.

    The first seed is that of the scenario; --set seed=201 goes on after 200. Any number of workers finds the same seed:
    the first one that fails. The exit status is 1 if a check failed, as with fleet run, and 0 if none did in the whole
    budget. With --keep the search uses the whole budget, and the same command goes on with a greater one; fleet regress
    DIR repeats the failures that it kept.

    \b
    Examples:
      fleet search nemesis --budget 200
      fleet search election --nemesis --budget '10 min'
      fleet search election --episodes
      fleet search election --liveness
      fleet search my.yaml --set seed=201 --check formation_error
      fleet search election --nemesis --budget 1000 --keep failures
      fleet search election --all 'partition|kill, at 2s..10s/1s, for 1s..6s/1s, up to 1'
    """
    from fleet.addons.studies.errors import StudyError

    if whole and (nemesis or episodes or liveness or keep is not None or junit is not None):
        raise click.UsageError(
            "--all makes every fault of a space: no --nemesis, --episodes, --liveness, --keep, --junit"
        )
    if whole:
        from fleet.addons.studies.verbs.whole_space import search_space

        tried, modules = _load_searched(scenario, changes, None)
        path, most = place_of(tried, out, force=force), None if budget == SEEDS_TO_TRY else budget[0]
        write = partial(write_least, path=path)
        search_space(tried, modules, whole, check, most, path, how, write, show_least)
        return
    if keep is not None and (out is not None or force):
        said = "--keep writes a file for each kind of failure"
        raise click.UsageError(f"{said}, so it cannot be used together with --out or --force")
    if nemesis + episodes + liveness > 1:
        raise click.UsageError("--nemesis, --episodes and --liveness each add another nemesis: give one of them")
    mode: NemesisMode = "liveness" if liveness else "episodes" if episodes else "swarm" if nemesis else None
    tried, modules = _load_searched(scenario, changes, mode)
    hunt = _Hunt(tried, check, keep, keep or place_of(tried, out, force=force))
    with how.showing(_seed_pieces(budget)) as on_progress, how.engine(modules) as engine:
        try:
            hunt.run(engine, on_progress, engine.carry(modules), budget)
        except KeyboardInterrupt:
            say(hunt.stopped(scenario), err=True)
            raise
    found = hunt.found
    again = f"fleet {'netem' if tried.nodes else 'run'} {scenario} --seed {found.seed}"
    cli_junit.write(junit, found.name, junit_cases.search_cases(found, hunt.kept, again))
    _print_search(found, hunt.least, check, hunt.path, hunt.kept)
    if found.scenario is not None:
        sys.exit(1)
    if not found.runs:
        raise StudyError("no run came to its end, so nothing is known")


class _Hunt:
    """A search, and the least scenarios of what it found."""

    def __init__(self, tried: Scenario, check: str | None, keep: Path | None, path: Path) -> None:
        """Prepare it; `path`: of the least scenario, or of the folder that keeps several."""
        from fleet.addons.studies.failures import FailureFolder, FoundFailure
        from fleet.addons.studies.search import SearchResult

        self._tried, self._check, self.path = tried, check, path
        self._folder = None if keep is None else FailureFolder(keep)
        self.found = SearchResult(tried.name, tried.seed)
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
        self, engine: Engine, on_progress: Callable[[str, int], None], modules: Modules, budget: tuple[float, float]
    ) -> None:
        """Search, and make what was found as small as it can be."""
        from fleet.addons.studies.failures import make_least
        from fleet.addons.studies.search import search

        most_runs, budget_s = budget
        found = search(self._tried, engine, partial(on_progress, SEEDS), check=self._check, most_runs=most_runs,
                       budget_s=budget_s, modules=modules, keep=self._folder)  # fmt: skip
        self.found = found
        if found.without:
            say(f"{found.without} runs have no result, the first one because of: {found.reason}", err=True)
        if self._folder is not None:
            make_least(self._folder, self._tried, engine, on_progress, modules, MOST_RUNS)
            self.kept = self._folder.of(self._tried)
        elif found.scenario is not None:
            self._shrink(found, found.scenario, engine, on_progress, modules)

    def _shrink(
        self,
        found: SearchResult,
        failing: Scenario,
        engine: Engine,
        on_progress: Callable[[str, int], None],
        modules: Modules,
    ) -> None:
        from fleet.addons.studies.shrink import Shrinker

        votes = found.votes.get(found.check)
        rate = f" in {votes[0]} of {votes[1]} runs" if votes else ""
        say(f"seed {found.seed} fails {found.check}{rate}, the first one from {found.first_seed} on", err=True)
        self.least = Shrinker(failing, engine, on_progress, modules).shrink(found.check, MOST_RUNS)
        write_least(self.least.scenario, self.path)


def _load_searched(name: str, changes: Iterable[str | Override], mode: NemesisMode) -> tuple[Scenario, Modules]:
    """The scenario of the search, and the modules that its runs need; `mode`: of the nemesis that the scenario gets."""
    from fleet.addons.studies.modules import modules_of
    from fleet.addons.studies.search import nemesis_of
    from fleet.addons.studies.study_file import refuse_study
    from fleet.scenario.loading import load_scenario

    refuse_study(name)
    tried = load_scenario(name, [*changes])
    if mode is not None:
        tried = load_scenario(name, [*changes, nemesis_of(tried, mode)])
    return tried, modules_of([tried], Path(name).parent if Path(name).exists() else None)


def _print_search(
    found: SearchResult, least: Shrunk | None, check: str | None, path: Path, kept: list[FoundFailure]
) -> None:
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import first_failing

        print_document(first_failing(found, least, path, kept))
        return
    if found.scenario is not None and least is not None:
        show_least(found.scenario, least, path, found.triggered)
    elif found.scenario is not None:
        say(f"{found.runs} runs, kinds of failure: {len(found.kinds)}")
        for failure in kept:
            since = f"first with seed {failure.from_seed}; " if failure.from_seed is not None else ""
            say(f"{failure.check}: {since}{failure.found}")
            click.echo(printable(failure.paste))  # whole, however narrow the terminal is
        click.echo(path)
    elif found.runs and found.most_failures is None:
        missed = "; ".join(one.words for one in found.reached if not one.hits)
        say(f"no failure found, but the runs did not get everywhere: {missed}")
    elif found.most_failures is not None:
        which = f"the check {check}" if check else "a check"
        say(f"none of {found.runs} runs fails {which}: at most {100 * found.most_failures:.2g} % of such runs do, "
            "with 95 % confidence")  # fmt: skip
    if (its := found.covered) is not None:
        drawn, faults = (", ".join(f"{count} {kind}" for kind, count in of.items()) for of in (its.kinds, its.faults))
        say(f"{its.episodes} episodes in units of {its.unit_s:g} s ({its.stated_by}): {drawn}; faults: {faults}")
        if found.scenario is None and its.two is not None and its.three is not None:
            say(
                f"each pattern of two isolations in three units was drawn with {100 * its.two:.2g} %, of three with "
                f"{100 * its.three:.2g} %"
            )
    for name, seed in found.unstated.items():
        say(f"seed {seed} fails {name}, which {found.name} does not state; --check {name} looks for it", err=True)
    for one in found.reached:
        if one.hits:
            say(one.words)


@command(document="fleet.addons.studies.verbs.documents.RegressedFolder")
def regress(
    folder: Annotated[Path, FOLDER],
    *,
    accept: Annotated[bool, Option("Expect the present verdicts from now on.")] = False,
    junit: Junit = None,
    how: WorkerOptions,
) -> None:
    """Repeat the failures that a search has kept, and compare their verdicts with the expected ones.

    The exit status is 0 if all are as expected, 1 if one is not, 3 if one has no result. After you mend a failure, it
    is no longer as expected: --accept then writes that all its checks must pass from now on.

    \b
    Examples:
      fleet search election --nemesis --keep failures
      fleet regress failures
      fleet regress failures --junit junit.xml
    """
    from fleet.addons.studies.failures import FailureFolder, Regression

    regression = Regression(FailureFolder(folder))
    of = len(regression.failures)
    modules = regression.modules
    with (
        how.showing(lambda _, made, of: [Piece(0, [f"{made} / {of} runs"])]) as on_progress,
        how.engine(modules) as engine,
    ):
        found = regression.run(engine, lambda made: on_progress(made, of), engine.carry(modules))
    if accept:
        found = regression.accept(found)
    cli_junit.write(junit, folder.name, junit_cases.regress_cases(found))
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import regress_document

        print_document(regress_document(folder, found))
    else:
        _show_regressed(found)
    if accept:
        say(f"{sum(one.accepted for one in found)} expected verdicts are changed", err=True)
    if any(one.broken for one in found):
        sys.exit(3)
    if not all(one.same for one in found):
        sys.exit(1)


def _show_regressed(found: Sequence[RegressionResult]) -> None:
    for one in found:
        failure = one.failure
        wanted = f"fails {failure.check}" if failure.expected == "fail" else "passes"
        verdict = "accepted" if one.accepted else "as expected" if one.same else "DIFFERS"
        say(f"{verdict}  {failure.file}: {one.got}"
            + ("" if one.same else f"; expected: {wanted}"))  # fmt: skip
        if not one.same:
            click.echo(printable(failure.paste))  # whole, however narrow the terminal is
        elif one.differs:
            say("  its log differs from the one that this version of fleet made before: did a law or a plant change?")
    say(f"{sum(one.same for one in found)} of {len(found)} are as expected")


@command(document="fleet.addons.studies.rare.RareFound")
def rare(
    scenario: Annotated[str, scenarios],
    *,
    check: Annotated[str, Option("The check whose failures are rare.", "NAME")],
    repeats: Annotated[int, Whole(1, 10_000), Option(
        "Independent estimates; their spread gives the interval.", "N")] = 20,
    effort: Annotated[int, Whole(4, 100_000), Option("The number of partial runs in each stage.", "N")] = 100,
    budget: Annotated[int | None, TIME, Option("Begin no repeat after this wall time, e.g. '10 min'.")] = None,
    changes: Changes,
    out: Annotated[Path | None, FILE, Option(
        "The file for estimates; a later call continues it. By default NAME-rare.json.", flag="-o --out")] = None,
    how: WorkerOptions,
) -> None:  # fmt: skip
    """Estimate how often a check fails, if failures are too rare to count.

    Runs that nearly failed continue from there several times, with other draws of network and sea (multilevel
    splitting on the margin of the check). Estimates in the file are not repeated.

    \b
    Examples:
      fleet rare lossy --check max_age --set 'checks.max_age.below=2 s'
      fleet rare my.yaml --check min_separation --repeats 50 --effort 200
    """
    from fleet.addons.studies.modules import modules_of
    from fleet.addons.studies.rare import RareEvent
    from fleet.addons.studies.splitting import Splitting
    from fleet.addons.studies.study_file import refuse_study
    from fleet.scenario.loading import load_scenario

    refuse_study(scenario)
    loaded = load_scenario(scenario, [*changes])
    modules = modules_of([loaded], Path(scenario).parent if Path(scenario).exists() else None)
    path = out or Path(f"{loaded.name}-rare.json")
    with how.showing(pieces) as on_progress, how.engine(modules) as engine:
        event = RareEvent(loaded, check, Splitting(effort), engine.carry(modules))
        found = event.run(engine, on_progress, repeats, path, inf if budget is None else budget / 1e9)
    print_result(found, *_rare_lines(found))


def _rare_lines(found: RareFound) -> Iterator[str]:
    interval = f"{found.low:.2g} to " + ("?" if found.high is None else f"{found.high:.2g}")
    yield f"{found.scenario} fails {found.check} with probability {found.probability:.3g} ({interval}, 95 %)"
    counting = (
        "" if found.counting is None else f"; plain Monte Carlo would need {found.counting:.2g} runs for this interval"
    )
    yield f"{found.repeats} repeats cost as much as {found.runs:.3g} runs{counting}"
    if found.decided:
        yield (
            f"in {found.decided} of them draws during the run made no difference. Draws before it, such as the "
            "initial state, decide there, and splitting does not help"
        )
    if not found.probability:
        yield "no repeat got as far as a failure: raise --effort or --repeats"
