"""The command `fleet shrink`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.completion import scenarios
from fleet.cli.documents.output import print_document
from fleet.cli.study_options import Making, changing_options, least_options, making_options
from fleet.cli.types import Whole
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.scenario.scenario import Scenario
    from fleet.scenario.text.overrides import Override
    from fleet.study.shrink import Shrunk
    from fleet.terminal.status_line import StatusLine
    from fleet.terminal.table import Piece

MOST_RUNS = 2000


@click.command()
@click.argument("failing", metavar="LOG|SCENARIO", shell_complete=scenarios)
@changing_options
@click.option("--check", metavar="NAME", help="The check that must still fail; by default the first that fails.")
@least_options
@click.option("--budget", metavar="RUNS", type=Whole(1), default=MOST_RUNS, show_default=True,
              help="Stop after this number of runs.")  # fmt: skip
@making_options()
def shrink(
    failing: str,
    changes: list[str | Override],
    check: str | None,
    out: Path | None,
    force: bool,
    budget: int,
    how: Making,
) -> None:
    """Make a run that fails a check as small as possible.

    The command removes faults and vehicles, shortens the run and its faults, and makes faults milder, as long as the
    check still fails. From a log it takes all faults, including injected ones. It writes the smallest scenario to a
    file.

    \b
    Examples:
      fleet shrink runs/latest
      fleet shrink nemesis --set seed=3 --check formation_error
      fleet shrink my.yaml --out least.yaml
    """
    from fleet.study.modules import modules_of
    from fleet.study.shrink import Shrinker

    scenario, folder = _scenario(failing, changes)
    path = place_of(scenario, out, force=force)
    modules = modules_of([scenario], folder)
    with how.showing(pieces) as tell, how.engine() as engine:
        try:
            found = Shrinker(scenario, engine, tell, engine.carry(modules)).shrink(check, budget)
        except KeyboardInterrupt:
            say(f"stopped, so {path} is not written; --budget N ends with the least scenario after N runs", err=True)
            raise
    write_least(found.scenario, path)
    if how.as_json:
        from fleet.cli.documents.studies import less

        print_document(less(found, scenario, path))
    else:
        show_least(scenario, found, path)


def place_of(scenario: Scenario, out: Path | None, *, force: bool) -> Path:
    """Where the least scenario goes. Raises StudyError: it cannot be written."""
    from fleet.study.errors import StudyError

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
    from fleet.study.errors import StudyError

    text = scenario.to_yaml()
    try:
        path.write_text(text, "utf-8")
    except OSError as error:
        click.echo(text, err=True)
        raise StudyError(f"{path} cannot be written: {error.strerror}; the least scenario stands above") from None


def pieces(line: StatusLine, doing: str, runs: int) -> list[Piece]:
    """The current trial, and the number of runs made."""
    from fleet.terminal.table import Piece

    return [Piece(0, [f"{runs} runs"]), Piece(1, [doing])]


def show_least(scenario: Scenario, found: Shrunk, path: Path) -> None:
    """Say what was made less, and where the least scenario is."""
    first, last = found.found
    say(f"{scenario.name} fails {found.check} with {first}, the least scenario with {last}; {found.runs} runs")
    for step in found.steps:
        say(f"  {step}")
    if not found.steps:
        say("  nothing can be left out")
    say(f"fleet run {path} fails it, too", err=True)
    click.echo(path)


def _scenario(name: str, changes: list[str | Override]) -> tuple[Scenario, Path | None]:
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.scenario.loading import load_scenario

    path = Path(name)
    if name in shipped_scenarios() or path.suffix in (".yaml", ".yml"):
        return load_scenario(name, changes), path.parent if path.exists() else None
    from fleet.repeat.recorded_run import recorded
    from fleet.scenario.trust import Policy

    return recorded(path).script(changes, Policy()), None


COMMANDS = (shrink,)
