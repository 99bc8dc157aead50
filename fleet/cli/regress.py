"""The command `fleet regress`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli import junit as cli_junit
from fleet.cli.documents.output import print_document
from fleet.cli.study_options import Making, making_options
from fleet.cli.types import FOLDER
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.study.failures import Regressed
    from fleet.terminal.status_line import StatusLine
    from fleet.terminal.table import Piece


@click.command()
@click.argument("folder", metavar="DIR", type=FOLDER)
@click.option("--accept", is_flag=True, help="Expect the present verdicts from now on.")
@cli_junit.JUNIT
@making_options()
def regress(folder: Path, accept: bool, junit: Path | None, how: Making) -> None:
    """Repeat the failures that a search has kept, and compare their verdicts with the expected ones.

    The exit status is 0 if all are as expected, 1 if one is not, 3 if one has no result. After you mend a failure, it
    is no longer as expected: --accept then writes that all its checks must pass from now on.

    \b
    Examples:
      fleet search election --nemesis --keep failures
      fleet regress failures
      fleet regress failures --junit junit.xml
    """
    from fleet.study.failures import FailureFolder, Regression

    regression = Regression(FailureFolder(folder))
    of = len(regression.failures)
    with how.showing(_pieces) as tell, how.engine() as engine:
        found = regression.run(engine, lambda made: tell(made, of), engine.carry(regression.modules))
    changed = regression.accept(found) if accept else 0
    cli_junit.write(junit, folder.name, cli_junit.of_regress(found))
    if how.as_json:
        from fleet.cli.documents.studies import regressed

        print_document(regressed(folder, found))
    else:
        _show(found)
    if accept:
        say(f"{changed} expected verdicts are changed", err=True)
    if any(one.broken for one in found):
        sys.exit(3)
    if not accept and not all(one.same for one in found):
        sys.exit(1)


def _pieces(line: StatusLine, made: int, of: int) -> list[Piece]:
    from fleet.terminal.table import Piece

    return [Piece(0, [f"{made} / {of} runs"])]


def _show(found: Sequence[Regressed]) -> None:
    for one in found:
        failure = one.failure
        wanted = f"fails {failure.check}" if failure.expected == "fail" else "passes"
        say(f"{'as expected' if one.same else 'DIFFERS'}  {failure.file}: {one.got}"
            + ("" if one.same else f"; expected: {wanted}"))  # fmt: skip
        if not one.same:
            click.echo(failure.paste)  # whole, however narrow the terminal is
        elif one.differs:
            say("  its log differs from the one that this version of fleet made before: did a law or a plant change?")
    say(f"{sum(one.same for one in found)} of {len(found)} are as expected")


COMMANDS = (regress,)
