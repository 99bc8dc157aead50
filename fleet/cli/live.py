"""The commands for live runs: inject, heal, clock, stop. `fleet status` has a module of its own."""

from __future__ import annotations

from typing import Any

import click

from fleet.cli import completion
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.run_argument import answer, clock_words, fault_words, heal_words, run_argument, run_option


@click.command()
@click.argument("what", metavar="[RUN] FAULT", nargs=-1, required=True, shell_complete=completion.injection)
@run_option
@click.option(
    "--for", "lasts", metavar="TIME", help="How long it lasts; by default to the end of the run, or until healed."
)
@click.option("--id", "name", metavar="ID", help="Its name; by default live-1, live-2, ...")
@json_option
def inject(what: tuple[str, ...], run: str | None, lasts: str | None, name: str | None, as_json: bool) -> None:
    """Inject a fault into a live run.

    It acts within half a second of simulated time. The command prints the time at which it began.

    \b
    Examples:
      fleet inject link '1<->2' 'delay 500ms loss 20%' --for 10s
      fleet inject partition '1,2 / 3,4'
      fleet inject partition halves for 5s      the words of run --fault
      fleet inject paper down '1->2'            of the run paper, if several live
      fleet inject down '2->3'
      fleet inject mute 3
      fleet inject kill 3                       for good, or until healed
      fleet inject kill 3 --for 5s              another agent takes over then
      fleet inject pause 2 --for 3s
      fleet inject slow vehicles=2 by='5 ticks'
      fleet inject current '0.2 0 0 m/s'
      fleet inject gust velocity='0 0.5 0 m/s' over=10s
      fleet inject efficiency vehicles=2 surge='50 %' --for 20s
    """
    from fleet.execution.answers import Injected
    from fleet.execution.connection import find
    from fleet.scenario.text.fault_words import read_fault

    run, text = fault_words(what, run)
    fault = read_fault(text)
    for key, value in (("for", lasts), ("id", name)):
        if value is not None and key in fault:
            raise click.UsageError(f"--{key} {value}: the fault says {key} {fault[key]} already; give one of them")
        if value is not None:
            fault[key] = value
    found = answer(Injected, find(run), "inject", fault=fault)
    if as_json:
        print_document(found)
        return
    until = f"until {found.to_s:.2f} s"
    if found.until_healed:
        until = f"until healed, at the latest the end at {found.to_s:g} s"
    click.echo(f"{found.run}: {found.id}: {found.what}, from t = {found.from_s:.2f} s {until}")


@click.command()
@click.argument("words", metavar="[RUN] [ID]", nargs=-1, shell_complete=completion.healing)
@run_option
@json_option
def heal(words: tuple[str, ...], run: str | None, as_json: bool) -> None:
    """End a fault of a live run, or all of them. fleet status shows their ids.

    \b
    Examples:
      fleet heal live-1
      fleet heal paper live-1
      fleet heal
    """
    from fleet.execution.answers import Healed
    from fleet.execution.connection import RemoteError

    meant, name = heal_words(words, run)
    try:
        found = answer(Healed, meant, "heal", id=name)
    except RemoteError as error:
        if run is not None or len(words) != 1 or name is None:
            raise
        raise RemoteError(f"{error}; and no live run is called {name!r}", error.status) from None
    if as_json:
        print_document(found)
        return
    click.echo(f"{found.run}: healed {', '.join(found.healed) or 'nothing'} at t = {found.at_s:.2f} s")


@click.command()
@click.argument("words", metavar="[RUN] pause|resume|step|speed [VALUE]", nargs=-1, required=True,
                shell_complete=completion.clock)  # fmt: skip
@run_option
@json_option
def clock(words: tuple[str, ...], run: str | None, as_json: bool) -> None:
    """Pause, step or pace a live run.

    \b
    Examples:
      fleet clock pause
      fleet clock step 10       ten ticks, then pause
      fleet clock speed 2       twice real time; max: as fast as possible
      fleet clock paper 2x      the same of the run paper, if several live
      fleet clock resume
    """
    from fleet.execution.answers import ClockSet
    from fleet.execution.connection import find

    run, do, value = clock_words(words, run)
    if do == "speed" and value is None:
        raise click.UsageError("no speed given: expected a multiple of real time such as 2, or max")
    number: Any = None
    try:
        if do == "step":
            number = int(value or 1)
        elif do == "speed" and value not in (None, "max"):
            number = float(str(value).removesuffix("x"))
        if number is not None and not 0 < number < 2**63:
            raise ValueError
    except ValueError:
        raise click.BadParameter(f"expected a number above 0, got {value!r}", param_hint="VALUE") from None
    found = answer(ClockSet, find(run), "clock", do=do, value=number)
    if as_json:
        print_document(found)
        return
    onward = "; fleet clock resume goes on" if found.clock == "paused" else ""
    click.echo(f"{found.run}: {found.clock}, t = {found.at_s:.2f} s{onward}")


@click.command()
@run_argument
@json_option
def stop(run: str | None, as_json: bool) -> None:
    """Stop a live run; what it has recorded stays.

    \b
    Examples:
      fleet stop
      fleet stop paper
    """
    from fleet.execution.answers import Stopping
    from fleet.execution.connection import find

    found = answer(Stopping, find(run), "stop")
    if as_json:
        print_document(found)
        return
    click.echo(f"{found.run}: stopping at t = {found.at_s:.2f} s")


COMMANDS = (inject, heal, clock, stop)
