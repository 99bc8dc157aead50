"""The command `fleet why`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.documents.output import print_document
from fleet.cli.log_argument import log_argument
from fleet.cli.study_options import Making, making_options
from fleet.cli.types import FILE, Whole
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.terminal.status_line import StatusLine
    from fleet.terminal.table import Piece

MOST_RUNS = 24


@click.command()
@log_argument
@click.option("--check", metavar="NAME", help="The check that failed; by default the first one that did.")
@click.option("--picture", metavar="FILE", type=FILE,
              help="Draw it into this file (png, svg, pdf).")  # fmt: skip
@click.option("--budget", metavar="RUNS", type=Whole(0, 10_000), default=MOST_RUNS, show_default=True,
              help="Healed runs that are tried; 0: only what the log says.")  # fmt: skip
@making_options()
def why(log: Path, check: str | None, picture: Path | None, budget: int, how: Making) -> None:
    """Explain why a check failed in LOG: faults, messages that did not arrive, and what each vehicle knew.

    It also finds the point of no return: the last moment from which the run still passes if all faults are healed. For
    that it makes the run again, and then runs that are healed at some moment.

    \b
    Examples:
      fleet why
      fleet why runs/latest --check formation_error --picture why.png
      fleet why runs/latest --budget 0
      fleet why runs/latest --json
    """
    from fleet.explanation.why import Explanation, Question

    if picture is not None:
        from fleet.explanation.picture import draw, format_of

        format_of(picture)
    with how.showing(_pieces) as tell:
        explanation = Explanation(Question(log, check, budget), tell)
        if explanation.searches:
            with how.engine() as engine:
                found = explanation.find(engine, engine.carry(explanation.modules))
        else:
            found = explanation.without_runs()
    if picture is not None:
        draw(found, explanation.path, explanation.scenario, picture)
    if how.as_json:
        print_document(found)
        return
    from fleet.explanation.why import lines

    say("\n".join([*lines(found), *([str(picture)] if picture is not None else [])]))


def _pieces(line: StatusLine, doing: str, runs: int) -> list[Piece]:
    from fleet.explanation.no_return import RUNS
    from fleet.terminal.table import Piece

    return [Piece(0, [doing]), Piece(1, [f"{runs} runs" if doing == RUNS else ""])]


COMMANDS = (why,)
