"""The commands for a live run: ps, status, inject, faults, heal, clock, stop; and script, which reads its log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import get_completion_class

from fleet.cli import completion

F = TypeVar("F", bound=Callable[..., Any])
# Faults that take KEY=VALUE pairs, with an example of each. A current may be written without.
_EXAMPLES = {
    "noise": "noise vehicles=2 position_noise='10 cm'",
    "bias": "bias vehicles=2 position='1 0 0 m'",
    "dropout": "dropout vehicles=2 probability='30 %'",
    "slow": "slow vehicles=2 by='5 ticks'",
    "gust": "gust velocity='0 0.5 0 m/s' over=10s",
    "current": "current mean='0.2 0 0 m/s' sigma='5 5 0 cm/s' time_constant=20s",
    "efficiency": "efficiency vehicles=2 surge='50 %'",
    "saturate": "saturate vehicles=2 yaw_moment='2 N m'",
    "wrench": "wrench vehicles=2 force='1 0 0 N'",
}


def which(command: F) -> F:
    """Add the options that choose a run."""
    command = click.option(
        "--run",
        "run",
        metavar="DIR",
        type=click.Path(path_type=Path),
        shell_complete=completion.runs,
        help="The run's directory; by default the newest live run.",
    )(command)
    return click.option(
        "--out",
        metavar="DIR",
        type=click.Path(path_type=Path),
        default=Path("runs"),
        show_default=True,
        help="Where run directories are.",
    )(command)


def _ask(run: Path | None, out: Path, op: str, **fields: Any) -> dict[str, Any]:
    from fleet.run.connection import ask, find

    return ask(find(run, out), op, **fields)


@click.command()
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path), default=Path("runs"), show_default=True,
              help="Where run directories are.")  # fmt: skip
def ps(out: Path) -> None:
    """List the live runs: directory, scenario, process, endpoint and simulated time."""
    from fleet.run.connection import RemoteError, ask, live_runs

    runs = live_runs(out)
    if not runs:
        click.echo(f"no live run under {out}", err=True)
    for found in runs:
        try:
            values = ask(found, "status")
            where = f"t = {values['at_s']:.1f} of {values['end_s']:g} s, {values['clock']}"
        except RemoteError as error:
            where = str(error)
        click.echo(f"{found.directory}  {found.scenario}  pid {found.pid}  {found.endpoint}  {where}")


@click.command()
@which
@click.option("-w", "--watch", is_flag=True, help="Again every second, until the run is over or Ctrl-C.")
def status(run: Path | None, out: Path, watch: bool) -> None:
    """Say how a live run is doing.

    \b
    Examples:
      fleet status
      fleet status -w --run runs/paper-1-20261121-120000
    """
    from fleet.recorder.metrics import WorstAndMedian
    from fleet.run.connection import RemoteError, find, is_live
    from fleet.run.connection import ask as ask_run

    shown = 0
    found = find(run, out)
    while True:
        try:
            values = ask_run(found, "status")
        except RemoteError:
            if shown and not is_live(found):
                click.echo(f"the run is over: {found.directory}")
                return
            raise
        lines = [
            f"{values['scenario']}: t = {values['at_s']:.2f} of {values['end_s']:g} s, {values['clock']}"
            + (f", {values['waiting']}" if values["waiting"] not in ("", values["clock"]) else ""),
            f"formation error {WorstAndMedian(**values['formation'])}, packets {values['delivered']} delivered, "
            f"{values['lost']} lost",
        ]
        lines += [f"fault {f['id']}: {f['what']}, until {f['to_s']:g} s" for f in values["faults"]]
        if values["tumbled"]:
            lines.append(f"tumbled: {', '.join(map(str, values['tumbled']))}")
        if values["dead"]:
            lines.append(f"without an agent: {', '.join(map(str, values['dead']))}")
        if shown and sys.stdout.isatty():
            click.echo(f"\x1b[{shown}A\x1b[J", nl=False)  # overwrite the lines printed before
        click.echo("\n".join(lines))
        shown = len(lines)
        if not watch:
            return
        time.sleep(1.0)


@click.command()
@click.argument("what", nargs=-1, required=True, shell_complete=completion.injection)
@which
@click.option("--for", "lasts", metavar="TIME", help="How long; by default to the end of the run, or until healed.")
@click.option("--id", "name", metavar="ID", help="What to call it; by default live-1, live-2, ...")
def inject(what: tuple[str, ...], run: Path | None, out: Path, lasts: str | None, name: str | None) -> None:
    """Inject a fault into a live run; it acts within half a second of simulated time, which is told.

    \b
    Examples:
      fleet inject link '1<->2' 'delay 500ms loss 20%' --for 10s
      fleet inject partition '1,2 / 3,4'
      fleet inject partition halves --for 5s
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
    from fleet.scenario.sections.timeline import ACTIONS
    from netem.parsing import nearest

    kind, rest = what[0], what[1:]
    if kind not in ACTIONS:
        hint = nearest(kind, ACTIONS) or f"there are {', '.join(ACTIONS)}"
        raise click.UsageError(f'no fault is called "{kind}": {hint}')
    fault: dict[str, Any]
    if kind == "link":
        if len(rest) < 2:
            raise click.UsageError("a link fault is: link SELECTOR CONDITION, as in link '1->2' 'loss 30%'")
        fault = {"link": {rest[0]: " ".join(rest[1:])}}
    elif (kind in _EXAMPLES and kind != "current") or (rest and "=" in rest[0]):
        pairs = [word.partition("=") for word in rest]
        if not pairs or not all(equals for _, equals, _ in pairs):
            raise click.UsageError(f"a {kind} fault is: {kind} KEY=VALUE ..., as in {_EXAMPLES[kind]}")
        fault = {kind: {key: value for key, _, value in pairs}}
    elif len(rest) < 1:
        raise click.UsageError(f"{kind} of what? See --help")
    else:
        fault = {kind: " ".join(rest)}
    if lasts is not None:
        fault["for"] = lasts
    if name is not None:
        fault["id"] = name
    values = _ask(run, out, "inject", fault=fault)
    click.echo(f"{values['id']}: {values['what']}, from t = {values['at_s']:.2f} s")


@click.command()
@which
def faults(run: Path | None, out: Path) -> None:
    """List the faults of a live run, with their ids."""
    for fault in _ask(run, out, "faults")["faults"]:
        times = f"{fault['from_s']:.2f} to {fault['to_s']:.2f} s"
        click.echo(f"{fault['id']:10}  {times:20}  {fault['state']:7}  {fault['what']}")


@click.command()
@click.argument("name", metavar="[ID]", required=False, shell_complete=completion.faults)
@which
def heal(name: str | None, run: Path | None, out: Path) -> None:
    """End a fault of a live run, or all of them."""
    values = _ask(run, out, "heal", id=name)
    healed = ", ".join(values["healed"]) or "nothing"
    click.echo(f"healed {healed} at t = {values['at_s']:.2f} s")


@click.command()
@click.argument("do", type=click.Choice(["pause", "resume", "step", "speed"]))
@click.argument("value", required=False)
@which
def clock(do: str, value: str | None, run: Path | None, out: Path) -> None:
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
    values = _ask(run, out, "clock", do=do, value=number)
    click.echo(f"{values['clock']}, t = {values['at_s']:.2f} s")


@click.command()
@which
def stop(run: Path | None, out: Path) -> None:
    """Stop a live run; what it has recorded stays."""
    values = _ask(run, out, "stop")
    click.echo(f"stopping at t = {values['at_s']:.2f} s")


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
def script(log: Path) -> None:
    """Print the scenario that runs LOG again, with everything that was injected while it was made.

    \b
    Examples:
      fleet script runs/latest > again.yaml && fleet run again.yaml
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


COMMANDS = (ps, status, inject, faults, heal, clock, stop, script, completion_command)
