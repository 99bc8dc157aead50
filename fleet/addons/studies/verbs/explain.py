"""The commands that explain a log: why and whatif."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fleet.addons.studies.verbs.study_options import WorkerOptions
from fleet.cli.changes import Overrides, key_options
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_result
from fleet.cli.log_argument import Log
from fleet.cli.types import FILE, NoProgress, Trust, Whole
from fleet.option import Option
from fleet.terminal.line import Piece
from fleet.terminal.progress import showing
from fleet.terminal.status_line import StatusLine
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.studies.explanation.what_if import WhatIf


@command(document="fleet.addons.studies.explanation.what_if.OtherCommands")
def whatif(
    log: Log,
    *,
    agent: Annotated[int, Whole(min=1), Option("The number of the vehicle.")],
    controller: Annotated[str | None, Option(
        "Short for --set controller=LAW: a name, or package.module:Class.", "LAW")] = None,
    overrides: Overrides = (),
    trust: Trust = False,
    plot: Annotated[Path | None, Option("Draw both commands into this file (png, svg, pdf).")] = None,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Give another agent the navigation and messages of one in LOG, and compare their commands.

    This is open loop: the vehicle still moves by the recorded commands. Without a change the commands are identical.

    \b
    Examples:
      fleet whatif --agent 3
      fleet whatif --agent 3 --controller bsmc --plot 3.png
      fleet whatif --agent 1 --set 'tracking.k_u=2 1/s' --set profile=hardened
      fleet whatif --agent 2 --controller my_module:MyController
    """
    from fleet.addons.studies.explanation.what_if import what_if

    changes = [*overrides, *key_options(controller=controller)]
    with showing(f"agent {agent}") as on_progress:
        found = what_if(log, agent, changes, on_progress)
    if plot is not None:
        from fleet.addons.studies.explanation.what_if import draw
        from fleet.mcap.reader import digest, log_path

        draw(found, plot, digest(log_path(log)))
    for note in () if json_is_asked() else found.notes:
        say(f"note  {note}", err=True)
    print_result(found.compared, *what_if_lines(found), *([str(plot)] if plot is not None else []))


def what_if_lines(found: WhatIf) -> list[str]:
    """The comparison in words."""
    shown = found.compared
    if not len(found.t):
        return [f"agent {found.agent} commanded nothing in this log"]
    lines = [
        f"agent {found.agent}: {shown.samples} samples from t = {found.t[0]:g} to {found.t[-1]:g} s, "
        f"{found.heard} messages heard, {found.lives} {'life' if found.lives == 1 else 'lives'}"
    ]
    if found.identical:
        return [*lines, "identical: every command is that of the log, to the last bit"]
    lines.append(f"the commands differ from t = {found.first_s:g} s on")
    lines += [
        f"  {name:<13} at most {c.max:.4g} {c.unit} away (t = {c.at_s:g} s), RMS {c.rms:.4g} {c.unit}"
        for name, c in shown.components.items()
    ]
    return lines


@command(document="fleet.addons.studies.explanation.why.Why")
def why(
    log: Log,
    *,
    check: Annotated[str | None, Option("The check that failed; by default the first one that did.", "NAME")] = None,
    picture: Annotated[Path | None, FILE, Option("Draw it into this file (png, svg, pdf).")] = None,
    budget: Annotated[int, Whole(0, 10_000), Option(
        "Healed runs that are tried; 0: only what the log says.", "RUNS")] = 24,
    how: WorkerOptions,
) -> None:  # fmt: skip
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
    from fleet.addons.studies.explanation.why import Explanation, Question, lines

    if picture is not None:
        from fleet.addons.pictures.style import format_of
        from fleet.addons.studies.explanation.picture import draw

        format_of(picture)
    with how.showing(_pieces) as on_progress:
        explanation = Explanation(Question(log, check, budget), on_progress)
        if explanation.searches:
            with how.engine(explanation.modules) as engine:
                found = explanation.find(engine, engine.carry(explanation.modules))
        else:
            found = explanation.without_runs()
    if picture is not None:
        draw(found, explanation.path, explanation.scenario, picture)
    print_result(found, *lines(found), *([str(picture)] if picture is not None else []))


def _pieces(line: StatusLine, doing: str, runs: int) -> list[Piece]:
    from fleet.addons.studies.explanation.no_return import RUNS

    return [Piece(0, [doing]), Piece(1, [f"{runs} runs" if doing == RUNS else ""])]
