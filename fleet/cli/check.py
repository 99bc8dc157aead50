"""The command `fleet check`: a scenario without running it, or a log by checks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import click

from fleet.cli.changes import Changes
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document, print_result
from fleet.cli.types import NoProgress, Trust
from fleet.option import Option
from fleet.terminal.progress import showing, showing_steps
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.errors import Problem
    from fleet.scenario.scenario import Scenario

_CHECK = "Exit status: 0 valid, or every check of a log passes; 1 one does not; 2 a mistake, or no log of ours."


@command(
    epilog=_CHECK,
    document={"check": "fleet.cli.documents.logs.Checked", "check LOG": "fleet.repeat.check_log.JudgedLog"},
)
def check(
    scenario: Annotated[str, scenarios, Option("", "SCENARIO|LOG")],
    *,
    changes: Changes,
    trust: Trust = False,
    quiet: NoProgress = False,
) -> None:
    """Check SCENARIO without running it, and report all mistakes at once; or judge LOG by checks.

    It then prints what theory predicts: whether the graph is connected and the reference reaches every vehicle, the
    eigenvalues of L+B, and whether the gains stay within the limits of the control loops. It also gives your own
    laws a first sample, and your plants a first step, as in a run.

    A LOG, which is an MCAP file or a run directory, is judged by the checks of its scenario on signals and in Python,
    or by those of --set, without running it again. If it was cut, it is judged up to where it is whole. Checks of other
    kinds, such as formation_error, are judged by the run.

    \b
    Examples:
      fleet check my.yaml
      fleet check paper --set vehicles=20
      fleet check paper --net '* delay 200ms' --fault 'at 20s kill 3'
      fleet check runs/latest --set 'checks={signal: {topic: state.z, below: 30 m}}'
    """
    if is_log(scenario):
        if changes.fault or changes.net:
            raise click.UsageError(f"{scenario} is a log: --net and --fault are for a scenario")
        _check_log(Path(scenario), changes.overrides)
    from fleet.analysis.first_sample import try_laws, try_plants
    from fleet.analysis.preflight import warnings
    from fleet.analysis.stability import analyse, report
    from fleet.scenario.loading import load_scenario

    refused: list[Problem] = []
    loaded = load_scenario(scenario, [*changes], refused=refused)
    if loaded.nodes:
        from fleet.analysis import command_lines
        from fleet.analysis import robot_addresses as of_nodes

        found, lines = analyse(loaded), of_nodes.summary(loaded)
        told = [*command_lines.warnings(loaded), *of_nodes.warnings(loaded)]
    else:
        try_laws(loaded)
        try_plants(loaded)
        with showing_steps("limits of the linear loop") as step:
            found = analyse(loaded, on_progress=step)
            told = [*found.warnings, *warnings(loaded)]
            lines = [] if json_is_asked() else report(loaded, found)
    if json_is_asked():
        from fleet.cli.documents.logs import check_document

        print_document(check_document(loaded, found, told, refused))
    elif loaded.nodes:
        say("\n".join(lines))
    else:
        _say_what_is_expected(loaded, lines, refused)
    for warning in [*(f"not checked: {problem}" for problem in refused), *told]:
        say(f"warning: {warning}", err=True)


def is_log(name: str) -> bool:
    """Whether an argument means a log: an MCAP file, or a directory that is no shipped scenario's name."""
    from fleet.scenario.catalogue import shipped_scenarios

    return name.endswith(".mcap") or (Path(name).is_dir() and name not in shipped_scenarios())


def _check_log(log: Path, overrides: tuple[str, ...]) -> NoReturn:
    from fleet.repeat.check_log import check_log
    from fleet.result.verdict import sort_failed_first

    with showing(f"reading {log}") as reading:
        found = check_log(log, overrides, reading)
    lines = [
        f"{verdict.mark}  {verdict.check}: {verdict.asked}; found {verdict.words}"
        for verdict in sort_failed_first(found.verdicts)
    ]
    missing = f", as far as the file goes: {found.missing}" if found.missing else ""
    print_result(found, *lines, f"judged up to t = {found.until_s:g} s of {found.end_s:g} s{missing}")
    sys.exit(0 if found.passed else 1)


def _say_what_is_expected(loaded: Scenario, lines: list[str], refused: list[Problem]) -> None:
    from fleet.analysis.link_shares import link_lines
    from fleet.analysis.randomness import may_draw
    from fleet.scenario.scenario import timeline_lines

    links = loaded.graph.links
    word = "valid as far as it was checked" if refused else "valid"
    say(
        f"{loaded.name}: {word}. {loaded.vehicles} vehicles, {len(links)} directed links, "
        f"{loaded.duration_ns / 1e9:g} s in {loaded.ticks} ticks of {loaded.tick_ns / 1e6:g} ms, "
        + ("ideal network" if loaded.ideal else f"a round every {loaded.round_ticks} ticks")
    )
    if loaded.spec.moored and not refused:
        every = [signal.name for i in range(1, loaded.vehicles + 1) for signal in loaded.layout(i).control]
        lines = [*lines, f"the agents report {', '.join(dict.fromkeys(every)) or 'nothing'}"]
    drawn = ", ".join(may_draw(loaded)) or "nothing, so every seed gives the same run"
    for line in [*lines, *link_lines(loaded), *timeline_lines(loaded), f"may draw from seed {loaded.seed}: {drawn}"]:
        say(line)
    if loaded.spec.expect == "fail":
        say("this run should fail a check (expect: fail); if it does, fleet run exits with 0")
