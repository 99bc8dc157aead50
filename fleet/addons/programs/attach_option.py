"""The option of `fleet run` for who wants to look into the program of an agent: `--attach`."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.programs.attachment import Attachment, attach
from fleet.cli.companion import Companion, RunCompanion
from fleet.errors import FleetError
from fleet.option import Option
from fleet.quantities import time_ns

if TYPE_CHECKING:
    from fleet.execution.options import Options
    from fleet.scenario.scenario import Scenario

_ASKED = re.compile(r"(?P<agent>\d+)(?P<gdb>:gdb)?(@(?P<at>.+))?")


@dataclass(frozen=True)
class AttachOptions:
    """The option of `fleet run` for who wants to look into a program."""

    attach: Annotated[str | None, Option(
        "Give the terminal to the program of an agent, as for breakpoint(); 3:gdb attaches gdb, at a time if you like.",
        "AGENT[:gdb[@TIME]]")] = None  # fmt: skip


class Attach(Companion):
    """Somebody sits at a program. Time does not pass for the others while he thinks, since it is simulated."""

    options_type = AttachOptions

    def prepare(self, scenario: Scenario, how: Options, one_process: str) -> Options:
        """Run in one process. Raises click.UsageError: there is no such program, or no terminal."""
        asked = self._asked(scenario)
        if not asked.gdb:
            text = f"what agent {asked.agent} prints is here and not in the log: its signals have no value"
            click.echo(f"note: {text}", err=True)
        return replace(how, in_process=True)

    @contextmanager
    def start(self, how: Options) -> Iterator[RunCompanion]:
        """As long as the run lasts, its agent finds what was asked for."""
        with attach(_read(self.options.attach or "")):
            yield RunCompanion()

    def _asked(self, scenario: Scenario) -> Attachment:
        asked = _read(self.options.attach or "")
        if not 1 <= asked.agent <= scenario.vehicles:
            raise click.UsageError(f"--attach: agents are 1 to {scenario.vehicles}, got {asked.agent}")
        law = scenario.agent_config(asked.agent).agent
        if law is None or not law.name.startswith("program:"):
            raise click.UsageError(f"--attach: agent {asked.agent} runs no program, see agent.program")
        if asked.gdb and shutil.which("gdb") is None:
            raise click.UsageError("--attach: there is no gdb here: install it")
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise click.UsageError("--attach needs a terminal: neither input nor output may be a file or a pipe")
        return asked


def _read(text: str) -> Attachment:
    found = _ASKED.fullmatch(text)
    if found is None or (found["at"] and not found["gdb"]):
        raise click.UsageError(f"--attach: expected an agent, such as 3, 3:gdb or 3:gdb@6.5s, got {text!r}")
    try:
        at_ns = time_ns(found["at"]) if found["at"] else 0
    except FleetError as error:
        raise click.UsageError(f"--attach: {error}") from None
    return Attachment(int(found["agent"]), bool(found["gdb"]), at_ns)
