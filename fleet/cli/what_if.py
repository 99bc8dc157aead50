"""`fleet whatif`: what a recorded vehicle would have commanded with another agent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.cli.log_argument import log_argument
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES, Whole, key_options
from fleet.terminal.table import say
from world.plugins.trust import Trust

if TYPE_CHECKING:
    from fleet.repeat.what_if import WhatIf


@click.command(cls=TrustingCommand, name="whatif")
@log_argument
@click.option("--agent", type=Whole(min=1), required=True, help="The number of the vehicle.")
@click.option("--controller", metavar="LAW", help="Short for --set controller=LAW: a name, or package.module:Class.")
@OVERRIDES
@trust_option
@click.option("--plot", type=click.Path(path_type=Path), help="Draw both commands into this file (png, svg, pdf).")
@json_option
def command(
    log: Path,
    agent: int,
    controller: str | None,
    overrides: tuple[str, ...],
    trust: Trust,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Give another agent the navigation and messages of one in LOG, and compare their commands.

    This is open loop: the vehicle still moves by the recorded commands. Without a change the commands are identical.

    \b
    Examples:
      fleet whatif --agent 3
      fleet whatif --agent 3 --controller bsmc --plot 3.png
      fleet whatif --agent 1 --set 'tracking.k_u=2 1/s' --set profile=hardened
      fleet whatif --agent 2 --controller my_module:MyController
    """
    from rich.console import Console
    from rich.status import Status

    from fleet.repeat.what_if import what_if

    changes = [*overrides, *key_options(controller=controller)]
    terminal = Console(stderr=True)
    with Status("reading the log", console=terminal) as status:
        tell = lambda share: status.update(f"agent {agent}: {100 * share:.0f} %")  # noqa: E731
        found = what_if(log, agent, changes, tell, trust)
    if plot is not None:
        from fleet.logs.reader import digest, log_path
        from fleet.repeat.what_if_picture import draw

        draw(found, plot, digest(log_path(log)))
    if as_json:
        from fleet.cli.documents.what_if import other_commands

        print_document(other_commands(found))
        return
    for note in found.notes:
        say(f"note  {note}", err=True)
    say("\n".join([*what_if_lines(found), *([str(plot)] if plot is not None else [])]))


def what_if_lines(found: WhatIf) -> list[str]:
    """The comparison in words."""
    from fleet.cli.documents.what_if import other_commands

    shown = other_commands(found)
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


COMMANDS = (command,)
