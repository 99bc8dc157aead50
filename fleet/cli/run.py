"""The command `fleet run`, and what it shares with others that make one run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import click

from fleet.cli import junit as cli_junit
from fleet.cli.changes import Changes, key_options
from fleet.cli.companion import Companion, Companions
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.cli.group import EPILOG, typed_command
from fleet.cli.junit import Junit
from fleet.cli.types import Trust, Whole, is_given
from fleet.execution.options import Options
from fleet.execution.wiring import USUAL, Wiring
from fleet.option import Option
from fleet.terminal.output import OutputError, give_up_output
from fleet.terminal.progress import showing
from fleet.terminal.status_line import stderr
from fleet.terminal.width import say, stdout
from netem.clock import Clock

if TYPE_CHECKING:
    from rich.console import Console as Terminal

    from fleet.recorder.start import Start
    from fleet.result.result import Result
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override

SEED = Whole(0, 2**63 - 1)
MOST_FAULTS = 20  # faults of the scenario that are said before it runs


@command(epilog=EPILOG, document="fleet.result.result.Result")
def run(
    scenario: Annotated[str | None, scenarios] = None,
    *,
    begin: Annotated[str | None, Option(
        "Continue a recorded run from a moment, in one process.", "LOG[@TIME]", "--from")] = None,
    seed: Annotated[int | None, SEED, Option("Override the scenario's seed.")] = None,
    duration: Annotated[str | None, Option("Override the scenario's duration, e.g. '20 s'.", "TIME")] = None,
    changes: Changes,
    trust: Trust = False,
    show_config: Annotated[bool, Option("Print the merged scenario and stop.")] = False,
    how: Options,
    companions: Companions,
    junit: Junit = None,
) -> None:  # fmt: skip
    """Run SCENARIO (a shipped name or a YAML file) and judge it.

    \b
    Examples:
      fleet run paper
      fleet run rough-sea --seed 3 --duration '70 s'
      fleet run paper --set vehicles=20 --net '* delay 200ms 50ms loss 30%'
      fleet run paper --fault 'at 20s for 10s partition halves'
      D=$(fleet run paper --in-process --quiet) && fleet plot $D
      fleet run paper --json > result.json
      fleet run paper --speed 1 --view
      fleet run --from runs/latest@20s --set controller=bsmc
    """
    if json_is_asked() and show_config:
        raise click.UsageError("--show-config prints YAML, so it cannot be used together with --json")
    asked_for = [*changes, *key_options(seed=seed, duration=duration)]
    if scenario is not None and begin is None and not how.in_process and not show_config:
        from fleet.processes.children import start_forkserver

        start_forkserver()  # now: it imports for as long as reading a scenario takes
    loaded, start = _load(scenario, begin, asked_for, quiet=how.quiet, only_shown=show_config)
    if show_config:
        click.echo(loaded.to_yaml(), nl=False)
        return
    terminal = stderr()
    if not how.quiet:
        from fleet.analysis.preflight import warnings
        from fleet.analysis.stability import analyse

        for warning in [*analyse(loaded).warnings, *warnings(loaded)]:
            say(f"warning: {warning}", err=True)
    beside = [each for each in companions if each.asked]
    asked, wiring = _check_options(loaded, start, how, beside, terminal)
    if asked.clock is Clock.REAL:  # also with --quiet, which is for progress and not for what will be gone
        say(f"warning: {_DEPRECATED_CLOCK}", err=True)
    if not how.quiet:
        _tell_plan(loaded, start, in_process=asked.in_process)
    execute_and_print(loaded, asked, beside, terminal, junit, wiring)


def execute_and_print(
    scenario: Scenario,
    options: Options,
    companions: Sequence[Companion],
    terminal: Terminal,
    junit: Path | None,
    wiring: Wiring = USUAL,
) -> NoReturn:
    """Run a scenario, print its result, and exit with its status.

    Args:
        scenario: what to run.
        options: how to run it. The companions have prepared this.
        companions: each does something beside the run.
        terminal: shows progress and warnings.
        junit: a JUnit file for the result. None writes none.
        wiring: how the run is connected. The companions have prepared this, too.
    """
    from fleet.execution.execute import execute

    scenario = _with_begun_faults(scenario, wiring.start, quiet=options.quiet)
    with ExitStack() as stack:
        beside = [stack.enter_context(each.start(options)) for each in companions]

        def on_published(directory: Path) -> None:
            for each in reversed(beside):  # what may end the run's wait for a listener, such as the page, comes last
                _tell(each.on_run_published, directory)

        result = execute(scenario, options, terminal, replace(wiring, on_published=on_published))
        if result.directory is not None:
            for each in beside:
                _tell(each.on_run_ended, result.directory)
        cli_junit.write(junit, result.scenario, cli_junit.run_cases(result, typed_command(without="--junit")))
        _print_result(result, quiet=options.quiet)
    sys.exit(result.status.exit)


def _with_begun_faults(scenario: Scenario, start: Start | None, *, quiet: bool) -> Scenario:
    """The scenario with the faults that its triggers begin. Unless it is to be quiet, each of them is printed."""
    if not scenario.spec.triggers:
        return scenario  # without the imports below

    from fleet.execution.triggered import resolve_triggers
    from fleet.scenario.scenario import fault_line, timeline
    from fleet.scenario.sections.triggers import moments

    names = moments(scenario.spec.triggers, scenario.spec)
    scenario = resolve_triggers(scenario, start)
    for fault in () if quiet else timeline(scenario):
        if fault.id in names:
            say(f"{fault_line(fault)}, {names[fault.id]}", err=True)
    return scenario


def _tell(hear: Callable[[Path], None], directory: Path) -> None:
    """Tell a companion something. Whatever it raises costs a warning, and neither the run nor its result."""
    try:
        hear(directory)
    except Exception as error:
        say(f"warning: {type(error).__name__} beside the run: {error}", err=True)


def _check_options(
    scenario: Scenario, start: Start | None, how: Options, companions: Sequence[Companion], terminal: Terminal
) -> tuple[Options, Wiring]:
    """How to run a scenario, and what it is connected to.

    Raises:
        UsageError, FleetError: options do not go together, or with the scenario.
    """
    one_process = (
        "--in-process" if how.in_process else "--from" if start else "network: ideal" if scenario.ideal else ""
    )
    _check_clock(how.speed, how.clock, one_process)
    wiring = Wiring(start=start)
    for companion in companions:
        how = companion.prepare(scenario, how, one_process)
        wiring = companion.wire(scenario, wiring, one_process)
    for warning in wiring.rendezvous.warnings if wiring.rendezvous else ():
        terminal.print(f"warning: {warning}", style="bold red", highlight=False, markup=False, soft_wrap=True)
    if how.wait_for_subscribers and not how.publish:
        raise click.UsageError(
            "--wait-for-subscribers needs --publish, or an option that publishes the run, too: without it there is "
            "nothing to subscribe to"
        )
    return how, wiring


def _tell_plan(scenario: Scenario, start: Start | None, *, in_process: bool) -> None:
    from fleet.scenario.scenario import timeline_lines

    for line in [*(start.notes if start else ()), *timeline_lines(scenario, MOST_FAULTS)]:
        say(line, err=True)
    if scenario.ideal and not in_process:
        say("network: ideal has no latency and so runs in one process", err=True)


def _print_result(result: Result, *, quiet: bool) -> None:
    from fleet.result.result import Status

    try:
        if json_is_asked() or quiet:
            _print_failure(result)
        if json_is_asked():
            print_document(result)
        elif quiet:
            click.echo(result.directory)
        else:
            from fleet.cli.result_table import show

            show(result, stdout())
        sys.stdout.flush()
    except OutputError as error:
        give_up_output()
        if error.reader_gone:
            return  # `head` has seen enough, and the status says how the run ended
        click.echo(f"fleet: {error}; the results are in {result.directory}", err=True)
        sys.exit(max(Status.BROKEN.exit, result.status.exit))


def _load(
    scenario: str | None, begin: str | None, changes: list[str | Override], *, quiet: bool, only_shown: bool
) -> tuple[Scenario, Start | None]:
    """The scenario to run, and where in a log it begins (`begin`: what --from says)."""
    from fleet.scenario.loading import load_scenario
    from fleet.scenario.text.overrides import SET, Override

    if begin is not None:
        from fleet.repeat.resume import continuation, parse_from

        with showing(f"reading {begin}", quiet=quiet) as on_progress:
            return continuation(*parse_from(begin), changes, scenario, on_progress)
    if scenario is None:
        raise click.UsageError("no scenario given: name one (see fleet list), or give --from LOG")
    # A scenario that is only shown may name laws that may not run.
    found = load_scenario(scenario, changes, refused=[] if only_shown else None)
    if found.nodes and not only_shown:  # here, a file of programs is one in simulated time
        return load_scenario(scenario, [*changes, Override(SET, "clock=simulated", "--clock simulated")]), None
    return found, None


_DEPRECATED_CLOCK = (
    "--clock real is deprecated, and the next major version may remove it: use --speed 1 to watch a run as it goes, "
    "and fleet netem for programs of your own on the wall clock"
)


def _check_clock(speed: float | None, clock: Clock, one_process: str) -> None:
    """Refuse options that do not go with the clock.

    `one_process`: which option or key asks for a run in one process, or "".
    """
    if clock != Clock.REAL:
        if is_given("max_missed"):
            raise click.UsageError("--max-missed is for --clock real: in lockstep no agent misses a tick")
        return
    if speed is None and is_given("speed"):
        raise click.UsageError("--clock real has no --speed max: give a number, such as 2 for twice real time")
    if one_process:
        raise click.UsageError(f"--clock real needs a run with processes, so not with {one_process}")


def _print_failure(result: Result) -> None:
    """Print a failure on stderr, if stdout has no tables. A failure that the scenario expects is not printed."""
    failed = [f"{v.mark}  {v.check}: {v.asked}; found {v.found}" for v in result.checks if not v.passed]
    if result.reason or (failed and not result.passed):
        lines = [f"fleet: {result.reason}", *result.lines] if result.reason else failed
        say("\n".join(lines), err=True)
