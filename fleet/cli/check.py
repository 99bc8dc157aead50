"""The command `fleet check`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from fleet.cli.completion import scenarios
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES, disturbances
from fleet.terminal.table import say
from world.plugins.trust import Trust

if TYPE_CHECKING:
    from fleet.errors import Problem
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override


@click.command(cls=TrustingCommand)
@click.argument("scenario", shell_complete=scenarios)
@OVERRIDES
@disturbances
@trust_option
@json_option
def check(
    scenario: str,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    trust: Trust,
    as_json: bool,
) -> None:
    """Check SCENARIO without running it, and report all mistakes at once.

    It then prints what theory predicts: whether the graph is connected and the reference reaches every vehicle, the
    eigenvalues of L+B, and whether the gains stay within the limits of the control loops. It also gives your own
    laws a first sample, and your plants a first step, as in a run.

    \b
    Examples:
      fleet check my.yaml
      fleet check paper --set vehicles=20
      fleet check paper --net '* delay 200ms' --fault 'at 20s kill 3'
    """
    from fleet.analysis.first_sample import try_laws, try_plants
    from fleet.analysis.preflight import warnings
    from fleet.analysis.stability import analyse, report
    from fleet.scenario.loading import load_scenario
    from fleet.terminal.status_line import showing_steps

    refused: list[Problem] = []
    loaded = load_scenario(scenario, [*overrides, *net, *fault], trust, refused=refused)
    try_laws(loaded)
    try_plants(loaded)
    with showing_steps("limits of the linear loop") as step:
        found = analyse(loaded, tell=step)
        told = [*found.warnings, *warnings(loaded)]
        lines = [] if as_json else report(loaded, found)
    if as_json:
        from fleet.cli.documents.check import checked

        print_document(checked(loaded, found, told, refused))
    else:
        _say_what_is_expected(loaded, lines, refused)
    for warning in [*(f"not checked: {problem}" for problem in refused), *told]:
        say(f"warning: {warning}", err=True)


def _say_what_is_expected(loaded: Scenario, lines: list[str], refused: list[Problem]) -> None:
    """A valid scenario in words, and what theory expects of it, which is `lines`."""
    from fleet.analysis.link_shares import link_lines
    from fleet.analysis.seed import HINT, NOTHING, seeded
    from fleet.scenario.scenario import timeline_lines

    links = loaded.graph.links
    word = "valid as far as it was checked" if refused else "valid"
    say(
        f"{loaded.name}: {word}. {loaded.vehicles} vehicles, {len(links)} directed links, "
        f"{loaded.duration_ns / 1e9:g} s in {loaded.ticks} ticks of {loaded.tick_ns / 1e6:g} ms, "
        + ("ideal network" if loaded.ideal else f"a round every {loaded.round_ticks} ticks")
    )
    for line in lines:
        say(line)
    for line in [*link_lines(loaded), *timeline_lines(loaded)]:
        say(line)
    drawn = seeded(loaded)
    say(f"drawn from seed {loaded.seed}: {', '.join(drawn)}" if drawn else f"{NOTHING}; {HINT}")
    if loaded.spec.expect == "fail":
        say("this run should fail a check (expect: fail); if it does, fleet run exits with 0")


COMMANDS = (check,)
