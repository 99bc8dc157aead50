"""The commands for a live run: ps, inject, faults, heal, clock, stop; and script, which reads its log."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import get_completion_class

from fleet.cli import completion
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.log_argument import log_argument

if TYPE_CHECKING:
    from fleet.execution.connection import LiveRun

F = TypeVar("F", bound=Callable[..., Any])
D = TypeVar("D")


def which(command: F) -> F:
    """Add the option that chooses a run."""
    return click.option(
        "--run",
        "run",
        metavar="NAME",
        shell_complete=completion.runs,
        help="The run: its name or the beginning of it, its scenario, or its directory; needed when several live.",
    )(command)


def which_by_name(command: F) -> F:
    """The same, with the name as an argument, too."""

    @wraps(command)
    def with_run(*arguments: Any, name: str | None, run: str | None, **options: Any) -> Any:
        if name is not None and run is not None and name != run:
            raise click.UsageError(f"which run? {name}, or --run {run}: give one of them")
        return command(*arguments, run=name if run is None else run, **options)

    argument = click.argument(
        "name", metavar="[RUN]", required=False, shell_complete=completion.runs,
        help="The run: its name or the beginning of it, its scenario, or its directory; needed when several live.",
    )  # fmt: skip
    return argument(which(with_run))  # type: ignore[return-value]


def _ask(kind: type[D], run: str | None, op: str, **fields: Any) -> D:
    """The answer of the run that is meant, with its name. Errors as `answer`."""
    from fleet.execution.connection import find

    return answer(kind, find(run), op, **fields)


def answer(kind: type[D], found: LiveRun, op: str, **fields: Any) -> D:
    """The answer of a run as a document of this kind.

    Raises:
        RemoteError: it does not answer in time, refuses, or answers something else.
    """
    import msgspec

    from fleet.execution.connection import RemoteError, ask

    values = {"run": found.name, "directory": str(found.directory), **ask(found, op, **fields)}
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise RemoteError(f"{found.name} answers as another version of uuv-fleet does: {error}") from None


@click.command()
@json_option
def ps(as_json: bool) -> None:
    """List the live runs of this user, wherever they were started.

    \b
    Examples:
      fleet ps
    """
    from fleet.cli.documents.live import LiveRunRow, LiveRuns
    from fleet.execution.connection import RemoteError, ask, live_runs

    rows = []
    for found in live_runs():
        row = LiveRunRow(found.name, str(found.directory), found.scenario, found.pid, found.endpoint)
        try:
            values = ask(found, "status")
            row.at_s, row.end_s, row.clock = values["at_s"], values["end_s"], values["clock"]
        except RemoteError as error:
            row.error = str(error)
        rows.append(row)
    if as_json:
        print_document(LiveRuns(rows))
        return
    if not rows:
        click.echo("no live run", err=True)
    for row in rows:
        click.echo(row.error or f"{row.run}: t = {row.at_s:.1f} of {row.end_s:g} s, {row.clock}")
        click.echo(f"  {row.directory}, pid {row.pid}")


@click.command()
@click.argument("what", nargs=-1, required=True, shell_complete=completion.injection)
@which
@click.option("--for", "lasts", metavar="TIME", help="How long; by default to the end of the run, or until healed.")
@click.option("--id", "name", metavar="ID", help="What to call it; by default live-1, live-2, ...")
@json_option
def inject(what: tuple[str, ...], run: str | None, lasts: str | None, name: str | None, as_json: bool) -> None:
    """Inject a fault into a live run; it acts within half a second of simulated time, which is told.

    \b
    Examples:
      fleet inject link '1<->2' 'delay 500ms loss 20%' --for 10s
      fleet inject partition '1,2 / 3,4'
      fleet inject partition halves for 5s      the words of run --fault
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
    from fleet.scenario.text.fault_words import read_fault

    fault = read_fault(" ".join(what))
    for key, value in (("for", lasts), ("id", name)):
        if value is not None and key in fault:
            raise click.UsageError(f"--{key} {value}: the fault says {key} {fault[key]} already; give one of them")
        if value is not None:
            fault[key] = value
    from fleet.cli.documents.live import Injected

    found = _ask(Injected, run, "inject", fault=fault)
    if as_json:
        print_document(found)
        return
    until = f"until {found.to_s:.2f} s"
    if found.until_healed:
        until = f"until healed, at the latest the end at {found.to_s:g} s"
    click.echo(f"{found.run}: {found.id}: {found.what}, from t = {found.from_s:.2f} s {until}")


@click.command()
@which_by_name
@json_option
def faults(run: str | None, as_json: bool) -> None:
    """List the faults of a live run, with their ids; below them what happened to vehicles.

    \b
    Examples:
      fleet faults
      fleet faults paper
    """
    from fleet.cli.documents.live import Faults

    document = _ask(Faults, run, "faults")
    if as_json:
        print_document(document)
        return
    click.echo(f"{document.run}: {len(document.faults) or 'no'} fault{'' if len(document.faults) == 1 else 's'}")
    for fault in document.faults:
        until = "until healed" if fault.until_healed else f"to {fault.to_s:.2f} s"
        times = f"{fault.from_s:.2f} s {until}"
        click.echo(f"{fault.id:10}  {times:22}  {fault.state:7}  {fault.what}")
    if document.events:
        click.echo("events of vehicles")
    for event in document.events:
        click.echo(f"  {event}")


@click.command()
@click.argument("name", metavar="[ID]", required=False, shell_complete=completion.faults)
@which
@json_option
def heal(name: str | None, run: str | None, as_json: bool) -> None:
    """End a fault of a live run, or all of them.

    \b
    Examples:
      fleet heal live-1
      fleet heal
    """
    from fleet.cli.documents.live import Healed

    found = _ask(Healed, run, "heal", id=name)
    if as_json:
        print_document(found)
        return
    click.echo(f"{found.run}: healed {', '.join(found.healed) or 'nothing'} at t = {found.at_s:.2f} s")


@click.command()
@click.argument("do", type=click.Choice(["pause", "resume", "step", "speed"]))
@click.argument("value", required=False)
@which
@json_option
def clock(do: str, value: str | None, run: str | None, as_json: bool) -> None:
    """Hold, step or pace a live run.

    \b
    Examples:
      fleet clock pause
      fleet clock step 10       ten ticks, then pause
      fleet clock speed 2       twice real time; max: as fast as it goes
      fleet clock resume
    """
    if do == "speed" and value is None:
        raise click.UsageError("which speed? A number of times real time, or max")
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
    from fleet.cli.documents.live import ClockSet

    found = _ask(ClockSet, run, "clock", do=do, value=number)
    if as_json:
        print_document(found)
        return
    onward = "; fleet clock resume goes on" if found.clock == "paused" else ""
    click.echo(f"{found.run}: {found.clock}, t = {found.at_s:.2f} s{onward}")


@click.command()
@which_by_name
@json_option
def stop(run: str | None, as_json: bool) -> None:
    """Stop a live run; what it has recorded stays.

    \b
    Examples:
      fleet stop
      fleet stop paper
    """
    from fleet.cli.documents.live import Stopping

    found = _ask(Stopping, run, "stop")
    if as_json:
        print_document(found)
        return
    click.echo(f"{found.run}: stopping at t = {found.at_s:.2f} s")


@click.command()
@log_argument
def script(log: Path) -> None:
    """Print the scenario that runs LOG again, with everything that was injected while it was made.

    \b
    Examples:
      fleet script > again.yaml && fleet run again.yaml
    """
    from fleet.repeat.recorded_run import script as make
    from fleet.terminal.progress import showing

    with showing(f"reading {log}") as tell:
        made = make(log, tell)
    click.echo(made.to_yaml(), nl=False)


@click.command(name="completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion_command(shell: str) -> None:
    """Print what makes a shell complete commands, scenarios, live runs, links, vehicles and faults.

    \b
    Examples:
      eval "$(fleet completion bash)"           in ~/.bashrc
      eval "$(fleet completion zsh)"            in ~/.zshrc
      fleet completion fish > ~/.config/fish/completions/fleet.fish
    """
    cls = get_completion_class(shell)
    assert cls is not None  # click has all three
    click.echo(cls(click.get_current_context().find_root().command, {}, "fleet", "_FLEET_COMPLETE").source())


COMMANDS = (ps, inject, faults, heal, clock, stop, script, completion_command)
