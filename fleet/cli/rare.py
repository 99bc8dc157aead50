"""The command `fleet rare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.completion import scenarios
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.shrink import pieces
from fleet.cli.study_options import SCHEDULER, WORKERS
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES, Whole, disturbances
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.scenario.text.overrides import Override
    from fleet.study.rare import RareFound
    from world.plugins.trust import Trust


@click.command(cls=TrustingCommand)
@click.argument("scenario", shell_complete=scenarios)
@click.option("--check", metavar="NAME", required=True, help="The check whose failures are rare.")
@click.option("--repeats", metavar="N", type=Whole(1, 10_000), default=20, show_default=True,
              help="Independent estimates; their spread gives the interval.")  # fmt: skip
@click.option("--effort", metavar="N", type=Whole(4, 100_000), default=100, show_default=True,
              help="The number of partial runs in each stage.")  # fmt: skip
@OVERRIDES
@disturbances
@click.option("-o", "--out", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False),
              help="The file for estimates; a later call continues it. By default NAME-rare.json.")  # fmt: skip
@WORKERS
@SCHEDULER
@trust_option
@json_option
def rare(
    scenario: str,
    check: str,
    repeats: int,
    effort: int,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    trust: Trust,
    as_json: bool,
) -> None:
    """Estimate how often a check fails, if failures are too rare to count.

    Runs that nearly failed continue from there several times, with other draws of network and sea (multilevel
    splitting on the margin of the check). Estimates in the file are not repeated.

    \b
    Examples:
      fleet rare lossy --check max_age --set 'checks.max_age.below=2 s'
      fleet rare my.yaml --check min_separation --repeats 50 --effort 200
    """
    from fleet.cli.study_output import showing
    from fleet.scenario.loading import changed, load_scenario
    from fleet.study.local_engine import engine_of
    from fleet.study.modules import modules_of
    from fleet.study.rare import RareEvent
    from fleet.study.splitting import Splitting
    from fleet.study.study_file import refuse_study

    refuse_study(scenario)
    loaded = load_scenario(scenario, [*overrides, *net, *fault], trust)
    if loaded.spec.log.snapshot is None:
        loaded = changed(loaded, ["log.snapshot=1 s"], trust)
    modules = modules_of([loaded], Path(scenario).parent if Path(scenario).exists() else None)
    path = out or Path(f"{loaded.name}-rare.json")
    with showing(pieces) as tell, engine_of(workers, scheduler) as engine:
        event = RareEvent(loaded, check, Splitting(effort), engine.carry(modules))
        found = event.run(engine, tell, repeats, path)
    if as_json:
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
