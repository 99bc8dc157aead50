"""The command line: `fleet run|check|list|info`. stdout is data, stderr is talk."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import click
from rich.console import Console as Terminal

from agents.plugins.trust import Trust
from fleet.cli import bench, join, live, logs, protocol, replay, verify, what_if
from fleet.cli import hosts as cli_hosts
from fleet.cli.completion import scenarios
from fleet.cli.failure import EPILOG, fail
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import Duration, Share, Speed
from fleet.errors import FleetError, Problem, ScenarioError
from fleet.terminal.output import OutputError, give_up_output


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EPILOG)
@click.version_option(package_name="uuv-fleet")
def cli() -> None:
    """Emulate a fleet of underwater vehicles on a real, impaired pub/sub network.

    \b
    Examples:
      fleet list                           the scenarios that ship with the package
      fleet run paper                      run one: processes over zenoh, an MCAP log, a verdict
      fleet run my.yaml --seed 7 --speed 1 your own file, another seed, in real time
      fleet info runs/latest/run.mcap      what a log holds
    """


_overrides = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override one scenario key, e.g. network.period='200 ms'.",
)


def _asked_for(name: str) -> bool:
    """Whether an option was given, not its default."""
    source = click.get_current_context().get_parameter_source(name)
    return source is not click.core.ParameterSource.DEFAULT


@cli.command(cls=TrustingCommand, epilog=EPILOG)
@click.argument("scenario", required=False, shell_complete=scenarios)
@click.option("--from", "begin", metavar="LOG[@TIME]", help="Go on from a snapshot in a log, in one process.")
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(path_type=Path),
    default=Path("runs"),
    show_default=True,
    help="Where run directories go.",
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Override the scenario's seed.")
@click.option("--duration", metavar="TIME", help="Override the scenario's duration, e.g. '20 s'.")
@click.option(
    "--speed",
    type=Speed(),
    default="max",
    show_default=True,
    help="Times real time, or as fast as it goes; with --clock real, 1.",
)
@click.option(
    "--clock",
    type=click.Choice(["lockstep", "real"]),
    default="lockstep",
    show_default=True,
    help="real: ticks begin by the wall clock and wait for nobody; the result says who was late.",
)
@click.option(
    "--max-missed",
    metavar="SHARE",
    type=Share(),
    default="1%",
    show_default=True,
    help="Of its ticks that an agent may miss with --clock real before the run fails.",
)
@click.option("--in-process", is_flag=True, help="One process, no zenoh; the same log, byte for byte.")
@_overrides
@trust_option
@click.option("--show-config", is_flag=True, help="Print the merged scenario and stop.")
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    help="Listen on this port of 127.0.0.1, too, for agents that cannot use the run's Unix socket.",
)
@click.option(
    "--publish", is_flag=True, help="Publish the journal on zenoh meanwhile; nobody who listens slows the run."
)
@click.option("--audit", is_flag=True, help="Say also which messages the router refuses, a tenth slower.")
@click.option("--wait-for-subscribers", is_flag=True, help="With --publish: begin when somebody listens.")
@cli_hosts.hosts_options
@click.option("--join-timeout", type=Duration(), default="300 s", show_default=True,
              help="How long to wait for each agent that somebody else starts.")  # fmt: skip
@click.option("--start-order", metavar="SEED", type=int, hidden=True)
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables.")
def run(
    scenario: str | None,
    begin: str | None,
    out: Path,
    seed: int | None,
    duration: str | None,
    speed: float | None,
    clock: str,
    max_missed: float,
    in_process: bool,
    overrides: tuple[str, ...],
    trust: Trust,
    show_config: bool,
    port: int | None,
    publish: bool,
    audit: bool,
    wait_for_subscribers: bool,
    join_timeout: int,
    start_order: int | None,
    quiet: bool,
    **hosts: Any,
) -> None:
    """Run SCENARIO (a shipped name or a YAML file) and judge it.

    \b
    Examples:
      fleet run paper
      fleet run rough-sea --seed 3 --duration '30 s'
      fleet run paper --set vehicles=20 --set "network.links={'*': 'delay 200ms 50ms loss 30%'}"
      fleet run paper --in-process --out /tmp/runs --quiet
      fleet run paper --clock real --speed 2
      fleet run --from runs/latest@20s --set controller=bsmc
    """
    from fleet.scenario.loading import load_scenario

    if wait_for_subscribers and not publish:
        raise click.UsageError("--wait-for-subscribers needs --publish: nobody could subscribe")
    more = list(overrides)
    if seed is not None:
        more.append(f"seed={seed}")
    if duration is not None:
        more.append(f"duration={duration}")
    terminal = Terminal(stderr=True)
    try:
        start = None
        if begin is not None:
            from fleet.repeat.resume import parse_from, prepare
            from fleet.terminal.share_done import showing

            with showing(f"reading {begin}", quiet=quiet) as tell:
                loaded, start = prepare(*parse_from(begin), more, scenario, trust, tell)
        elif scenario is None:
            raise click.UsageError("run what? A scenario, or --from a log; see fleet list")
        else:
            # To show it nothing needs to run.
            loaded = load_scenario(scenario, more, trust, refused=[] if show_config else None)
        if show_config:
            click.echo(loaded.to_yaml(), nl=False)
            return
        from fleet.cli.result_table import show
        from fleet.run.execute import Options, Status, execute

        if not quiet:
            from fleet.analysis.preflight import doubts
            from fleet.analysis.seed import HINT, NOTHING, chances
            from fleet.analysis.stability import analyse

            idle = [f"--seed: {NOTHING}; {HINT}"] if seed is not None and not chances(loaded) else []
            for warning in [*analyse(loaded).warnings, *doubts(loaded), *idle]:
                terminal.print(f"warning: {warning}", highlight=False, markup=False, soft_wrap=True)
        meeting = cli_hosts.meeting(loaded, hosts, in_process=in_process or loaded.ideal or start is not None)
        for warning in meeting.warnings if meeting else ():
            terminal.print(f"warning: {warning}", style="bold red", highlight=False, markup=False, soft_wrap=True)
        pace = None
        given = [name for name in ("speed", "max_missed") if _asked_for(name)]
        if clock == "real":
            if speed is None and "speed" in given:
                raise click.UsageError("--clock real has no max: --speed 2 is twice as fast as the wall clock")
            pace = speed or 1.0
            if in_process or start is not None or loaded.ideal:
                why = "--in-process" if in_process else "--from" if start is not None else "network: ideal"
                raise click.UsageError(f"--clock real is of processes that answer as they can; not with {why}")
        elif "max_missed" in given:
            raise click.UsageError("--max-missed is for --clock real: in lockstep nobody misses a tick")
        if audit and (in_process or loaded.ideal or start is not None or (meeting and meeting.router)):
            raise click.UsageError("--audit reads the log of the router that a run hosts; this run hosts none")
        options = Options(
            out,
            in_process=in_process,
            speed=speed,
            quiet=quiet,
            publish=publish,
            wait=wait_for_subscribers,
            port=port,
            start=start,
            pace=pace,
            most_missed=max_missed,
            start_order=_shuffle(start_order),
            join_timeout_s=join_timeout / 1e9,
            meeting=meeting,
            audit=audit,
        )
        if start is not None and not quiet:
            terminal.print("\n".join(start.notes), highlight=False, markup=False, soft_wrap=True)
        if loaded.ideal and not in_process and not quiet:
            terminal.print("network: ideal has no latency and so runs in one process", highlight=False)
        result = execute(loaded, options, terminal)
    except FleetError as error:
        fail(error)
    if quiet:
        failed = [f"FAIL  {v.check}: {v.asked}; found {v.found}" for v in result.verdicts if not v.passed]
        if result.reason or (failed and result.status):  # not where it was meant to fail
            said = [f"fleet: {result.reason}", *result.lines] if result.reason else failed
            click.echo("\n".join([*said, str(result.directory)]), err=True)
    else:
        try:
            show(result, Terminal(width=None if sys.stdout.isatty() else 120, soft_wrap=False))
            sys.stdout.flush()
        except OutputError as error:
            give_up_output()
            click.echo(f"fleet: {error}; the results are in {result.directory}", err=True)
            sys.exit(max(Status.BROKEN, result.status))
    sys.exit(int(result.status))


def _shuffle(seed: int | None) -> Any:
    if seed is None:
        return None
    from random import Random

    def shuffled(roles: list[str]) -> list[str]:
        return Random(seed).sample(roles, len(roles))

    return shuffled


@cli.command(cls=TrustingCommand)
@click.argument("scenario", shell_complete=scenarios)
@_overrides
@trust_option
def check(scenario: str, overrides: tuple[str, ...], trust: Trust) -> None:
    """Check SCENARIO without running it; every mistake is reported in one pass.

    Says what theory expects of it: whether the graph is connected and everyone reached, the eigenvalues of L+B, and
    whether the gains stay within the limits of the control loops.

    \b
    Examples:
      fleet check my.yaml
      fleet check paper --set vehicles=20
    """
    from fleet.scenario.loading import load_scenario

    refused: list[Problem] = []
    try:
        loaded = load_scenario(scenario, overrides, trust, refused=refused)
    except ScenarioError as error:
        fail(error)
    from fleet.analysis.preflight import doubts
    from fleet.analysis.seed import HINT, NOTHING, chances
    from fleet.analysis.stability import analyse, report
    from fleet.scenario.scenario import timeline

    links = loaded.graph.links
    word = "valid as far as it was checked" if refused else "valid"
    click.echo(
        f"{loaded.name}: {word}. {loaded.vehicles} vehicles, {len(links)} directed links, "
        f"{loaded.duration_ns / 1e9:g} s in {loaded.ticks} ticks of {loaded.tick_ns / 1e6:g} ms, "
        + ("ideal network" if loaded.ideal else f"a round every {loaded.round_ticks} ticks")
    )
    found = analyse(loaded)
    for line in report(loaded, found):
        click.echo(line)
    for name, begin_s, end_s, what in timeline(loaded):
        click.echo(f"fault {name}: {what}, {begin_s:g} to {end_s:g} s")
    drawn = chances(loaded)
    click.echo(f"seed {loaded.seed} draws: {', '.join(drawn)}" if drawn else f"{NOTHING}; {HINT}")
    if loaded.spec.expect == "fail":
        click.echo("the run is meant to fail a check, and exits with 0 when it does (expect: fail)")
    for warning in [*(f"not checked: {problem}" for problem in refused), *found.warnings, *doubts(loaded)]:
        click.echo(f"warning: {warning}", err=True)


@cli.command()
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("reproduction"),
    show_default=True,
    help="Where report.md, metrics.json and the pictures go.",
)
@click.option("--jobs", metavar="N", type=click.IntRange(1, 256), help="Runs at a time; by default one per core.")
@click.option(
    "--case",
    "cases",
    metavar="NAME",
    multiple=True,
    help="Only runs whose name begins with NAME; repeatable.",
)
@click.option("--format", "formats", type=click.Choice(["png", "svg", "pdf"]), multiple=True, default=("png",),
              show_default=True, help="Format of the pictures; repeatable.")  # fmt: skip
def reproduce(out: Path, jobs: int | None, cases: tuple[str, ...], formats: tuple[str, ...]) -> None:
    """Run the paper's simulation section again and judge each of its claims.

    Five controllers, undisturbed and disturbed, under the printed and the corrected cost, over no network and over
    one, in parallel; pictures for every figure of the paper, and a report with a verdict on every claim.

    \b
    Examples:
      fleet reproduce
      fleet reproduce --out /tmp/paper --jobs 4 --format png --format pdf
      fleet reproduce --case nboc --case nbc-disturbed
    """
    from rich.table import Table

    from fleet.reproduce.cases import CASES
    from fleet.reproduce.progress import showing

    names = [name for name in CASES if not cases or any(name.lower().startswith(c.lower()) for c in cases)]
    for case in cases:
        if not any(name.lower().startswith(case.lower()) for name in CASES):
            raise click.BadParameter(f"no run begins with {case!r}; there are {', '.join(CASES)}", param_hint="--case")
    from fleet.reproduce.run import reproduce as run_all

    terminal = Terminal(stderr=True)
    try:
        with showing(terminal) as tell:
            path, claims, _ = run_all(out, jobs or _cores(), names, formats, tell)
    except FleetError as error:
        click.echo(f"fleet: {error}", err=True)
        sys.exit(3)
    table = Table(box=None, pad_edge=False)
    for heading in ("verdict", "claim", "under which reading"):
        table.add_column(heading)
    colours = {"reproduced": "green", "partly": "yellow", "not reproduced": "red"}
    for claim in claims:
        table.add_row(f"[{colours[claim.verdict]}]{claim.verdict}[/]", claim.text, claim.readings)
    output = Terminal(width=None if sys.stdout.isatty() else 150)
    if claims:
        output.print(table)
    else:
        output.print("no claim can be judged on these runs alone", highlight=False)
    output.print(str(path), highlight=False, soft_wrap=True)


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0))


@cli.group()
def new() -> None:
    """Begin something of your own from a template."""


@new.command()
@click.argument("name")
@click.option(
    "--kind",
    type=click.Choice(["controller", "guidance", "tracking", "agent"]),
    default="controller",
    show_default=True,
    help="What it replaces: guidance and tracking, one of them, or the whole agent.",
)
@click.option(
    "--dir",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Where to write; by default here.",
)
def controller(name: str, kind: str, folder: Path) -> None:
    """Write NAME.py, a control law that runs as it is, and NAME.yaml, a scenario that uses it.

    \b
    Examples:
      fleet new controller pid
      fleet new controller swarm --kind guidance --dir laws
    """
    from fleet.cli.new import write_law

    try:
        law, scenario = write_law(kind, name, folder)
    except FleetError as error:
        fail(error)
    below = folder.resolve().is_relative_to(Path().resolve())  # from elsewhere it would ask for --trust
    there, file = ("", scenario) if below else (f"cd {shlex.quote(str(folder))} && ", scenario.name)
    click.echo(f"wrote {law} and {scenario}; now: {there}fleet run {shlex.quote(str(file))}")


@cli.command(name="list")
def list_() -> None:
    """List the scenarios that ship with the package."""
    from rich.table import Table

    from fleet.scenario.loading import list_scenarios

    table = Table(box=None, pad_edge=False)
    for heading in ("scenario", "vehicles", "duration", "meant to", "what one learns"):
        table.add_column(heading, no_wrap=heading != "what one learns")
    for name, title, vehicles, duration_s, expect in list_scenarios():
        table.add_row(name, str(vehicles), f"{duration_s:g} s", expect, title)
    Terminal(width=None if sys.stdout.isatty() else 120).print(table)


@cli.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def info(log: Path, as_json: bool) -> None:
    """Say what LOG (an MCAP file, or a run directory) holds, also when it was cut short.

    \b
    Examples:
      fleet info runs/latest
      fleet info runs/latest/run.mcap --json
    """
    from fleet.logs.info import describe, read_info
    from fleet.terminal.share_done import showing

    try:
        with showing(f"reading {log}") as tell:
            found = read_info(log, tell)
    except FleetError as error:
        fail(error)
    click.echo(json.dumps(found.to_values(), indent=2) if as_json else describe(found))


_GROUPS = (bench, cli_hosts, join, live, logs, protocol, replay, verify, what_if)
for _command in (command for group in _GROUPS for command in group.COMMANDS):
    cli.add_command(_command)
