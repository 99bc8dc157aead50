"""The command `fleet rare`."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.completion import scenarios
from fleet.cli.documents.output import print_document
from fleet.cli.shrink import pieces
from fleet.cli.study_options import Making, changing_options, making_options
from fleet.cli.types import FILE, TIME, Whole
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.scenario.text.overrides import Override
    from fleet.study.rare import RareFound


@click.command()
@click.argument("scenario", shell_complete=scenarios)
@click.option("--check", metavar="NAME", required=True, help="The check whose failures are rare.")
@click.option("--repeats", metavar="N", type=Whole(1, 10_000), default=20, show_default=True,
              help="Independent estimates; their spread gives the interval.")  # fmt: skip
@click.option("--effort", metavar="N", type=Whole(4, 100_000), default=100, show_default=True,
              help="The number of partial runs in each stage.")  # fmt: skip
@click.option("--budget", metavar="TIME", type=TIME, help="Begin no repeat after this wall time, e.g. '10 min'.")
@changing_options
@click.option("-o", "--out", metavar="FILE", type=FILE,
              help="The file for estimates; a later call continues it. By default NAME-rare.json.")  # fmt: skip
@making_options()
def rare(
    scenario: str,
    check: str,
    repeats: int,
    effort: int,
    budget: int | None,
    changes: list[str | Override],
    out: Path | None,
    how: Making,
) -> None:
    """Estimate how often a check fails, if failures are too rare to count.

    Runs that nearly failed continue from there several times, with other draws of network and sea (multilevel
    splitting on the margin of the check). Estimates in the file are not repeated.

    \b
    Examples:
      fleet rare lossy --check max_age --set 'checks.max_age.below=2 s'
      fleet rare my.yaml --check min_separation --repeats 50 --effort 200
    """
    from fleet.scenario.loading import changed, load_scenario
    from fleet.study.modules import modules_of
    from fleet.study.rare import RareEvent, Splitting
    from fleet.study.study_file import refuse_study

    refuse_study(scenario)
    loaded = load_scenario(scenario, changes)
    if loaded.spec.log.snapshot is None:
        loaded = changed(loaded, ["log.snapshot=1 s"])
    modules = modules_of([loaded], Path(scenario).parent if Path(scenario).exists() else None)
    path = out or Path(f"{loaded.name}-rare.json")
    with how.showing(pieces) as tell, how.engine() as engine:
        event = RareEvent(loaded, check, Splitting(effort), engine.carry(modules))
        found = event.run(engine, tell, repeats, path, inf if budget is None else budget / 1e9)
    if how.as_json:
        print_document(found)
    else:
        _print(found)


def _print(found: RareFound) -> None:
    interval = f"{found.low:.2g} to " + ("?" if found.high is None else f"{found.high:.2g}")
    say(f"{found.scenario} fails {found.check} with probability {found.probability:.3g} ({interval}, 95 %)")
    counting = "" if found.counting is None else f"; counting needs {found.counting:.2g} runs for such an interval"
    say(f"{found.repeats} repeats cost as much as {found.runs:.3g} runs{counting}")
    if found.decided:
        say(f"in {found.decided} of them draws during the run made no difference. Draws before it, such as the "
            f"initial state, decide there, and splitting does not help")  # fmt: skip
    if not found.probability:
        say("no repeat got as far as a failure: raise --effort or --repeats")


COMMANDS = (rare,)
