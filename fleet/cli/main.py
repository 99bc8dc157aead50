"""The command line: the group of all commands, with `fleet check` and `fleet list`.

Data go to stdout, everything else to stderr.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from fleet.cli import (
    bench,
    hosts,
    join,
    live,
    logs,
    new,
    protocol,
    replay,
    reproduce,
    run,
    runs,
    status,
    verify,
    what_if,
)
from fleet.cli.completion import scenarios
from fleet.cli.group import EPILOG, FleetGroup
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES

if TYPE_CHECKING:
    from agents.plugins.trust import Trust
    from fleet.errors import Problem


@click.group(
    cls=FleetGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EPILOG
)
@click.version_option(package_name="uuv-fleet")
def cli() -> None:
    """Emulate a fleet of underwater vehicles on a real, impaired pub/sub network.

    \b
    Examples:
      fleet list                           the scenarios that ship with the package
      fleet run paper                      run one: processes over zenoh, an MCAP log, a verdict
      fleet run my.yaml --seed 7 --speed 1 your own file, another seed, in real time
      fleet info                           what the log of the newest run holds
    """


@cli.command(cls=TrustingCommand)
@click.argument("scenario", shell_complete=scenarios)
@OVERRIDES
@trust_option
def check(scenario: str, overrides: tuple[str, ...], trust: Trust) -> None:
    """Check SCENARIO without running it; every mistake is reported in one pass.

    Says what theory expects of it: whether the graph is connected and everyone reached, the eigenvalues of L+B, and
    whether the gains stay within the limits of the control loops. A law of your own is made once and given a first
    sample, as in a run.

    \b
    Examples:
      fleet check my.yaml
      fleet check paper --set vehicles=20
    """
    from fleet.scenario.loading import load_scenario

    refused: list[Problem] = []
    loaded = load_scenario(scenario, overrides, trust, refused=refused)
    from fleet.analysis.first_sample import try_laws

    try_laws(loaded)
    from fleet.analysis.preflight import warnings
    from fleet.analysis.seed import HINT, NOTHING, seeded
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
    drawn = seeded(loaded)
    click.echo(f"seed {loaded.seed} draws: {', '.join(drawn)}" if drawn else f"{NOTHING}; {HINT}")
    if loaded.spec.expect == "fail":
        click.echo("the run is meant to fail a check, and exits with 0 when it does (expect: fail)")
    for warning in [*(f"not checked: {problem}" for problem in refused), *found.warnings, *warnings(loaded)]:
        click.echo(f"warning: {warning}", err=True)


@cli.command(name="list")
def list_() -> None:
    """List the scenarios that ship with the package."""
    from rich.console import Console as Terminal
    from rich.table import Table

    from fleet.scenario.catalogue import list_scenarios

    table = Table(box=None, pad_edge=False)
    for heading in ("scenario", "vehicles", "duration", "meant to", "what one learns"):
        table.add_column(heading, no_wrap=heading != "what one learns")
    for name, title, vehicles, duration_s, expect in list_scenarios():
        table.add_row(name, str(vehicles), f"{duration_s:g} s", expect, title)
    Terminal(width=None if sys.stdout.isatty() else 120).print(table)


for _module in (bench, hosts, join, live, logs, new, protocol, replay, reproduce, run, runs, status, verify, what_if):
    for _command in _module.COMMANDS:
        cli.add_command(_command)
