"""The command `fleet run`."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from fleet.cli import hosts as cli_hosts
from fleet.cli import junit as cli_junit
from fleet.cli import ros2 as cli_ros2
from fleet.cli import view as cli_view
from fleet.cli.completion import scenarios
from fleet.cli.documents.output import json_is_asked, json_option, print_document
from fleet.cli.group import EPILOG
from fleet.cli.junit import JUNIT
from fleet.cli.types import OVERRIDES, PATH, SHARE, SPEED, TIME, TRUST, Whole, disturbances, is_given, key_options
from fleet.terminal.output import OutputError, give_up_output
from fleet.terminal.status_line import showing, stderr
from fleet.terminal.table import say, stdout
from netem.vehicle_clock import Clock

if TYPE_CHECKING:
    from rich.console import Console as Terminal

    from fleet.execution.options import Options
    from fleet.recorder.start import Start
    from fleet.result.result import Result
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override

MOST_FAULTS = 20  # of the scenario, said before it runs


@dataclass(frozen=True, kw_only=True, slots=True)
class RunOptions(cli_hosts.HostsOptions):
    """How the command line asks for a run."""

    out: Path
    speed: float | None
    clock: str
    max_missed: float
    in_process: bool
    port: int | None
    publish: bool
    view: bool
    ros2: bool
    wait_for_subscribers: bool
    join_timeout: int  # ns


@click.command(epilog=EPILOG)
@click.argument("scenario", required=False, shell_complete=scenarios)
@click.option("--from", "begin", metavar="LOG[@TIME]", help="Continue a recorded run from a moment, in one process.")
@click.option("-o", "--out", metavar="DIR", type=PATH, default=Path("runs"), show_default=True,
              help="The folder for run directories.")  # fmt: skip
@click.option("--seed", type=Whole(0, 2**63 - 1), help="Override the scenario's seed.")
@click.option("--duration", metavar="TIME", help="Override the scenario's duration, e.g. '20 s'.")
@click.option("--speed", type=SPEED, default="max", show_default=True,
              help="Speed in multiples of real time, or as fast as possible; with --clock real, 1.")  # fmt: skip
@click.option("--clock", type=click.Choice([each.value for each in Clock]), default=Clock.LOCKSTEP.value,
              show_default=True,
              help="real: ticks begin by the wall clock and wait for no agent; the result lists late "
                   "agents.")  # fmt: skip
@click.option("--max-missed", type=SHARE, default="1%", show_default=True,
              help="With --clock real: the run fails if an agent misses a larger share of its ticks.")  # fmt: skip
@click.option("--in-process", is_flag=True, help="One process, no zenoh; the same log, byte for byte.")
@OVERRIDES
@disturbances
@TRUST
@click.option("--show-config", is_flag=True, help="Print the merged scenario and stop.")
@click.option("--port", type=Whole(1, 65535),
              help="Listen on this port of 127.0.0.1, too, for agents that cannot use the run's Unix "
                   "socket.")  # fmt: skip
@click.option("--publish", is_flag=True,
              help="Publish the journal on zenoh during the run; slow listeners do not slow the run.")  # fmt: skip
@click.option("--view", is_flag=True,
              help="Open a page in the browser that shows the run; there you can also disturb it.")  # fmt: skip
@click.option("--ros2", is_flag=True, help="Publish the run, and show it to ROS 2 as fleet ros2 does.")
@click.option("--wait-for-subscribers", is_flag=True,
              help="With --publish, --view or --ros2: begin when there is a listener, such as the page.")  # fmt: skip
@cli_hosts.hosts_options
@click.option("--join-timeout", type=TIME, default="300 s", show_default=True,
              help="How long to wait for each external agent.")  # fmt: skip
@json_option
@JUNIT
@click.option("-q", "--quiet", is_flag=True, help="Print only the run's directory; failures go to stderr.")
def run(
    scenario: str | None,
    begin: str | None,
    seed: int | None,
    duration: str | None,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    show_config: bool,
    junit: Path | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Run SCENARIO (a shipped name or a YAML file) and judge it.

    \b
    Examples:
      fleet run paper
      fleet run rough-sea --seed 3 --duration '70 s'
      fleet run paper --set vehicles=20 --net '* delay 200ms 50ms loss 30%'
      fleet run paper --fault 'at 20s for 10s partition halves'
      D=$(fleet run paper --in-process --quiet) && fleet plot $D
      fleet run paper --json > result.json
      fleet run paper --clock real --speed 2
      fleet run paper --speed 1 --view
      fleet run --from runs/latest@20s --set controller=bsmc
    """
    how = RunOptions(**options)
    _check_output(how, show_config=show_config)
    changes: list[str | Override] = [*overrides, *net, *fault]
    changes += key_options(seed=seed, duration=duration)
    if scenario is not None and begin is None and not how.in_process and not show_config:
        from fleet.processes.children import start_forkserver

        start_forkserver()  # now: it imports for as long as reading a scenario takes
    loaded, start = _load(scenario, begin, changes, quiet=quiet, only_shown=show_config)
    if loaded.nodes and not show_config:
        raise click.UsageError(f"{loaded.source} has nodes, whose programs are yours: fleet netem {loaded.source}")
    if show_config:
        click.echo(loaded.to_yaml(), nl=False)
        return
    terminal = stderr()
    if not quiet:
        from fleet.analysis.preflight import warnings
        from fleet.analysis.stability import analyse

        for warning in [*analyse(loaded).warnings, *warnings(loaded)]:
            say(f"warning: {warning}", err=True)
    asked = replace(_options(loaded, start, how, terminal), quiet=quiet)
    if not quiet:
        _tell_plan(loaded, start, in_process=asked.in_process)
    _execute(loaded, asked, terminal, view=how.view, ros2=how.ros2, junit=junit)


def _check_output(how: RunOptions, *, show_config: bool) -> None:
    if how.wait_for_subscribers and not (how.publish or how.view or how.ros2):
        raise click.UsageError(
            "--wait-for-subscribers needs --publish, --view or --ros2: without them there is nothing to subscribe to"
        )
    if json_is_asked() and show_config:
        raise click.UsageError("--show-config prints YAML, so it cannot be used together with --json")


def _execute(
    scenario: Scenario, options: Options, terminal: Terminal, *, view: bool, ros2: bool, junit: Path | None
) -> NoReturn:
    """Run a scenario, beside the page (`view`) and the bridge (`ros2`) if they are wanted; print the result, exit."""
    from fleet.execution.execute import execute

    with (
        cli_view.page_process(asked=view, stays=not (options.quiet or json_is_asked())) as page,
        cli_ros2.bridge_process(asked=ros2) as bridge,
    ):

        def on_published(directory: Path) -> None:
            if bridge is not None:
                bridge.start(directory)
            if page is not None:
                page.published(directory)

        result = execute(scenario, replace(options, on_published=on_published), terminal)
        if page is not None and result.directory is not None:
            page.over(result.directory)
        cli_junit.write(junit, result.scenario, cli_junit.of_run(result))
        _print_result(result, quiet=options.quiet)
    sys.exit(result.status.exit)


def _options(scenario: Scenario, start: Start | None, how: RunOptions, terminal: Terminal) -> Options:
    """How to run a scenario. Raises UsageError, FleetError: options do not go together, or with the scenario."""
    from fleet.execution.options import Options

    one_process = (
        "--in-process" if how.in_process else "--from" if start else "network: ideal" if scenario.ideal else ""
    )
    place = cli_hosts.rendezvous(scenario, how, in_process=bool(one_process))
    for warning in place.warnings if place else ():
        terminal.print(f"warning: {warning}", style="bold red", highlight=False, markup=False, soft_wrap=True)
    _check_clock(how.speed, how.clock, one_process)
    if how.ros2 and one_process:
        raise click.UsageError(
            f"--ros2 needs a run with processes, so not with {one_process}; fleet ros2 plays its log afterwards"
        )
    if how.view and one_process:
        raise click.UsageError(
            f"--view needs a run with processes, so not with {one_process}; fleet view shows its log afterwards"
        )
    return Options(
        how.out,
        in_process=how.in_process,
        clock=Clock(how.clock),
        speed=how.speed,
        publish=how.publish or how.view or how.ros2,
        wait=how.wait_for_subscribers,
        port=how.port,
        start=start,
        most_missed=how.max_missed,
        join_timeout_s=how.join_timeout / 1e9,
        rendezvous=place,
    )


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

    if begin is not None:
        from fleet.repeat.resume import continuation, parse_from

        with showing(f"reading {begin}", quiet=quiet) as tell:
            return continuation(*parse_from(begin), changes, scenario, tell)
    if scenario is None:
        raise click.UsageError("no scenario given: name one (see fleet list), or give --from LOG")
    # A scenario that is only shown may name laws that may not run.
    return load_scenario(scenario, changes, refused=[] if only_shown else None), None


def _check_clock(speed: float | None, clock: str, one_process: str) -> None:
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


@click.command(epilog="Exit status: 0 pass, 1 a check failed, 2 usage or bad file, 3 the run broke.")
@click.argument("stack", metavar="STACK", type=PATH)
@click.option("-o", "--out", metavar="DIR", type=PATH, default=Path("runs"), show_default=True,
              help="The folder for run directories.")  # fmt: skip
@click.option("--seed", type=Whole(0, 2**63 - 1), help="Override the file's seed.")
@click.option("--duration", metavar="TIME", help="End after this time, e.g. '5 min'; else with Ctrl-C or fleet stop.")
@OVERRIDES
@disturbances
@TRUST
@click.option("--show-config", is_flag=True, help="Print the merged file and stop.")
@click.option("--view", is_flag=True, help="Open a page in the browser that shows the run.")
@json_option
@JUNIT
@click.option("-q", "--quiet", is_flag=True, help="Print only the run's directory; failures go to stderr.")
def netem(
    stack: Path,
    out: Path,
    seed: int | None,
    duration: str | None,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    show_config: bool,
    view: bool,
    junit: Path | None,
    quiet: bool,
) -> None:
    """Put the network of the file STACK between robots whose programs are yours, and judge what it carried.

    Each node is a robot: its programs connect to an address of ours, or we join a router of theirs. Time is the wall
    clock. Ctrl-C ends the run, prints the verdict and the table of links, and leaves a log.

    \b
    Examples:
      fleet netem stack.yaml
      fleet netem stack.yaml --net '* delay 300ms 50ms loss 20%' --duration '2 min'
      fleet inject partition 'auv1 / auv2,shore' --for 30s
      fleet netem stack.yaml --view
    """
    from fleet.execution.options import Options
    from fleet.processes.children import start_forkserver
    from fleet.scenario.loading import load_scenario
    from fleet.stack.lines import warnings
    from fleet.stack.run import RelayRun

    if not show_config:
        start_forkserver()
    changes: list[str | Override] = [*overrides, *net, *fault, *key_options(seed=seed, duration=duration)]
    scenario = load_scenario(stack, changes)
    if not scenario.nodes:
        raise click.UsageError(f"{stack} has no nodes: fleet run {stack} runs it with agents of its own")
    if show_config:
        click.echo(scenario.to_yaml(), nl=False)
        return
    if not quiet:
        for text in warnings(scenario):
            say(f"warning: {text}", err=True)
    asked = Options(out, clock=Clock.REAL, quiet=quiet, publish=view, relay=RelayRun)
    _execute(scenario, asked, stderr(), view=view, ros2=False, junit=junit)


COMMANDS = (run, netem)
