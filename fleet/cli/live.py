"""The commands for live runs: status, inject, heal, clock, stop, and which run they mean."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

import click

from fleet.cli import completion
from fleet.cli.completion import CLOCK_WORDS
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document, print_result
from fleet.cli.group import USAGE
from fleet.option import Option
from fleet.terminal.status_line import rewritable
from fleet.terminal.width import stdout

if TYPE_CHECKING:
    from rich.console import Console, Group
    from rich.table import Table

    from fleet.execution.answers import FaultRow, LinkRow, RunStatus, VehicleRow
    from fleet.execution.connection import LiveRun


D = TypeVar("D")
_HELP = (
    "The run: its name or the beginning of it, its scenario, or its directory. Needed if several live here, "
    "or if it lives below another folder."
)
_TIMES = ("at", "for", "id")  # words that may stand before the kind of a fault
_PACE = re.compile(r"max|[\d.]+x", re.ASCII)


RunOption = Annotated[str | None, completion.runs, Option(_HELP, "NAME", "--run")]
RunName = Annotated[str | None, completion.runs, Option(_HELP, "[RUN]")]


def _one(name: str | None, run: str | None) -> str | None:
    """The run by position and that of --run. Raises UsageError: they are two."""
    if name is not None and run is not None and name != run:
        raise click.UsageError(f"which run? {name}, or --run {run}: give one of them")
    return name if run is None else run


def answer(kind: type[D], found: LiveRun, op: str, **fields: Any) -> D:
    """The answer of a run as a document of this kind.

    Raises RemoteError: it does not answer in time, refuses, or answers something else.
    """
    import msgspec

    from fleet.execution.connection import RemoteError, ask

    values = {"run": found.name, "directory": str(found.directory), **ask(found, op, **fields)}
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise RemoteError(f"{found.name} answers as another version of uuv-fleet does: {error}") from None


def fault_words(words: tuple[str, ...], run: str | None) -> tuple[str | None, str]:
    """The run that stands in front of a fault, if one does, or that of --run, and the fault.

    A kind of fault in front is no run, unless another kind stands behind it: `partition kill 3` kills an agent of the
    run `partition`. Raises UsageError: the first word begins no fault, and no fault stands behind it.
    """
    from fleet.scenario.schema.faults import ACTIONS

    text = " ".join(words)
    first, second, *_ = [*re.findall(r"[^\s'\"{}]+", text), "", ""]
    if first in _TIMES or not first or (first in ACTIONS and second not in ACTIONS):
        return run, text
    if second in ACTIONS or second in _TIMES:
        return _one(first, run), text.split(None, 1)[1]
    if run is None:
        _refuse(first, ACTIONS, "no fault", f"name the fault, too: fleet inject {first} kill 3")
    return run, text  # a mistake in the text is told when it is read


def clock_words(words: tuple[str, ...], run: str | None) -> tuple[str | None, str, str | None]:
    """The run, what its clock is to do, and how many ticks or how fast; `2x` is short for `speed 2`.

    Raises UsageError: nothing of that.
    """
    first, second, *_ = [*words, "", ""]
    rest = list(words)
    if second in CLOCK_WORDS or (first and first not in CLOCK_WORDS and not _PACE.fullmatch(first)):
        run = _one(rest.pop(0), run)
    do, *values = rest or [""]
    if _PACE.fullmatch(do):
        do, values = "speed", [do, *values]
    if not do and first:
        _refuse(first, CLOCK_WORDS, "nothing that a clock does", f"say what its clock does: fleet clock {first} pause")
    if do not in CLOCK_WORDS or len(values) > (do in ("step", "speed")):
        expected = "pause, resume, step [TICKS], speed X, or a speed such as 2x or max"
        raise click.UsageError(f"expected {expected}; got {' '.join([do, *values]) or 'nothing'}")
    return run, do, values[0] if values else None


def _refuse(word: str, known: Sequence[str], no: str, otherwise: str) -> NoReturn:
    """Raise UsageError about a word that is either mistyped or a run, with what to do in both cases."""
    from netem.parsing import nearest, quoted

    hint = nearest(word, known) or f"there are {', '.join(known)}"
    raise click.UsageError(f"{quoted(word)} is {no}: {hint}\nIf it is a run, {otherwise}")


def heal_words(words: tuple[str, ...], run: str | None) -> tuple[LiveRun, str | None]:
    """The run and the id of the fault to heal; None: all of them.

    One word is the name of a run if there is such a run, and else the id of a fault.

    Raises UsageError: more than two words, or two runs; RemoteError: there is no such run, or the word is the name of a
    run and a fault of the only one, too.
    """
    from fleet.execution.connection import RemoteError, ask, find, live_runs

    if len(words) > 2:
        raise click.UsageError(f"expected a run and the id of a fault at most, got {' '.join(words)}")
    if run is not None or len(words) != 1:
        name = _one(words[0], run) if len(words) == 2 else run
        return find(name, to_act=True), words[-1] if words else None
    (word,) = words
    try:
        named = find(word)
    except RemoteError as error:
        if error.status == USAGE or "/" in word:
            raise
        return find(to_act=True), word
    if len(live_runs()) == 1 and any(fault["id"] == word for fault in ask(named, "faults")["faults"]):
        name = named.name
        both = f"fleet heal {name} (all its faults) or fleet heal {name} {word} (that one)"
        raise RemoteError(f"{word} is the run {name}, and a fault of it: say {both}", USAGE)
    return named, None


@command(document="fleet.execution.answers.Injected")
def inject(
    what: Annotated[tuple[str, ...], completion.injection, Option("", "[RUN] FAULT")],
    *,
    run: RunOption = None,
    lasts: Annotated[str | None, Option(
        "How long it lasts; by default to the end of the run, or until healed.", "TIME", "--for")] = None,
    name: Annotated[str | None, Option("Its name; by default live-1, live-2, ...", "ID", "--id")] = None,
) -> None:  # fmt: skip
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
    found = answer(Injected, find(run, to_act=True), "inject", fault=fault)
    until = f"until {found.to_s:.2f} s"
    if found.until_healed:
        until = f"until healed, at the latest the end at {found.to_s:g} s"
    print_result(found, f"{found.run}: {found.id}: {found.what}, from t = {found.from_s:.2f} s {until}")


@command(document="fleet.execution.answers.Healed")
def heal(
    words: Annotated[tuple[str, ...], completion.healing, Option("", "[RUN] [ID]")] = (), *, run: RunOption = None
) -> None:
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
    print_result(found, f"{found.run}: healed {', '.join(found.healed) or 'nothing'} at t = {found.at_s:.2f} s")


@command(document="fleet.execution.answers.ClockSet")
def clock(
    words: Annotated[tuple[str, ...], completion.clock, Option("", "[RUN] pause|resume|step|speed [VALUE]")],
    *,
    run: RunOption = None,
) -> None:
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
    found = answer(ClockSet, find(run, to_act=True), "clock", do=do, value=number)
    onward = "; fleet clock resume goes on" if found.clock == "paused" else ""
    print_result(found, f"{found.run}: {found.clock}, t = {found.at_s:.2f} s{onward}")


@command(document="fleet.execution.answers.Stopping")
def stop(name: RunName = None, *, run: RunOption = None) -> None:
    """Stop a live run; what it has recorded stays.

    \b
    Examples:
      fleet stop
      fleet stop paper
    """
    from fleet.execution.answers import Stopping
    from fleet.execution.connection import find

    found = answer(Stopping, find(_one(name, run), to_act=True), "stop")
    print_result(found, f"{found.run}: stopping at t = {found.at_s:.2f} s")


EVERY_S = 1.0
MOST_FAULTS = 5
MOST_EVENTS = 3


@command(document="fleet.execution.answers.RunStatus")
def status(
    name: RunName = None,
    *,
    run: RunOption = None,
    watch: Annotated[bool, Option(
        "Repeat every second, until the run is over or Ctrl-C.", flag="-w --watch")] = False,
    every: Annotated[bool, Option(
        "All vehicles, links and faults, not only the worst and active.", flag="--all")] = False,
) -> None:  # fmt: skip
    """Show the state of a live run.

    It prints the time, the processes that the run waits for, and active faults with their ids. The fate of vehicles
    follows, then the worst vehicles and links. "oldest data" is the age of the stalest message that a vehicle still
    relies on. e is the consensus error. fleet info shows the log of a run.

    \b
    Examples:
      fleet status
      fleet status paper --all
      fleet status -w paper-1-20261121-120000
    """
    if watch and json_is_asked():
        raise click.UsageError("--json prints one document, and --watch many: give one of them")
    from fleet.execution.connection import find

    found = find(_one(name, run))
    if watch:
        watch_run(found, every, stdout())
    elif json_is_asked():
        print_document(_status(found, every))
    else:
        stdout().print(screen(_status(found, every), every))


def _status(found: LiveRun, every: bool) -> RunStatus:
    from fleet.execution.answers import RunStatus

    return answer(RunStatus, found, "status", all=every)


def watch_run(found: LiveRun, every: bool, terminal: Console) -> None:
    """Show it again and again: on a terminal in place, on a screen of its own; elsewhere one block after the other."""
    from rich.live import Live

    from fleet.execution.connection import RemoteError, is_live

    in_place = rewritable(terminal) and not terminal.is_dumb_terminal
    values = _status(found, every)
    try:
        with Live(console=terminal, screen=True, auto_refresh=False) if in_place else nullcontext() as live:
            while True:
                if live is None:
                    terminal.print(screen(values, every), "")
                else:
                    live.update(screen(values, every, terminal.height), refresh=True)
                time.sleep(EVERY_S)
                try:
                    values = _status(found, every)
                except RemoteError:
                    if is_live(found):
                        raise
                    break
    finally:
        if in_place:
            terminal.print(screen(values, every))  # the screen of its own is gone; what it showed last stays
    click.echo(f"{found.name}: the run is over; its results are in {found.directory}")


def screen(status: RunStatus, every: bool, height: int | None = None) -> Group:
    """A status as a terminal shows it, in 80 columns.

    `every`: the user asked for all vehicles and links. `height`: of the screen that the text must fit [lines]; None:
    any length.
    """
    from rich.console import Group
    from rich.text import Text

    # Moored vehicles are where they began, and so are all at the start.
    placed = any(error for row in status.vehicles for error in (row.formation_m, row.e_m))
    formation = [f"formation error {status.formation}"] if placed else []
    lines = [
        f"{status.run}: t = {status.at_s:.2f} of {status.end_s:g} s, {status.clock}",
        *([_nodes(status)] if status.nodes else formation),
        f"packets {status.delivered} delivered, {status.lost} lost",
    ]
    if status.waiting not in ("", status.clock):
        lines.append(status.waiting)
    whole = every and height is None
    faults, events = (None, None) if whole else (MOST_FAULTS, MOST_EVENTS)
    lines += [_fault(fault, status) for fault in status.faults[:faults]]
    if faults is not None and len(status.faults) > faults:
        lines.append(f"and {_more(len(status.faults) - faults, 'fault')}: fleet status --all")
    lines += [f"event {event}" for event in status.events[:events]]
    if events is not None and len(status.events) > events:
        lines.append(f"and events of {_more(len(status.events) - events, 'vehicle')}: fleet status --all")
    vehicles, links = status.vehicles, status.links
    if height is not None:
        room = height - len(lines) - 3  # two headings, and a line on what is left out
        links = links[: max(room // 3, room - len(vehicles), 1)]
        vehicles = _worst(vehicles, max(room - len(links), 1))
    parts = [Text(line, overflow="ellipsis", no_wrap=height is not None) for line in lines]
    left_out = [
        _more(total - shown, what)
        for what, shown, total in (
            ("vehicle", len(vehicles), status.vehicles_total),
            ("link", len(links), status.links_total),
        )
        if shown < total
    ]
    tail = [Text(f"and {' and '.join(left_out)}{'' if every else ': --all'}")] if left_out else []
    tables = [_links(links)] if status.nodes else [_vehicles(vehicles, placed=placed), _links(links)]
    return Group(*parts, *tables, *tail)


def _nodes(status: RunStatus) -> str:
    return f"nodes {', '.join(f'{name} (not running)' if name in status.gone else name for name in status.nodes)}"


def _more(count: int, what: str) -> str:
    return f"{count} more {what}{'' if count == 1 else 's'}"


def _worst(vehicles: list[VehicleRow], most: int) -> list[VehicleRow]:
    from fleet.execution.live_status import badness

    worst = sorted(vehicles, key=lambda row: -badness(row.formation_m))[:most]
    return sorted(worst, key=lambda row: row.vehicle)


def _fault(fault: FaultRow, status: RunStatus) -> str:
    if fault.state != "active":
        return f"fault {fault.id}: {fault.state}, {fault.from_s:.2f} s to {fault.to_s:.2f} s: {fault.what}"
    left = f"{max(0.0, fault.to_s - status.at_s):.1f} s left"
    if fault.to_s >= status.end_s:
        left = "until healed" if fault.until_healed else "to the end"
    return f"fault {fault.id}: {left}: {fault.what}"


def _vehicles(rows: list[VehicleRow], *, placed: bool) -> Table:
    table = _table("UUV", "state", *(["formation error", "e", "settled"] if placed else []), "oldest data")
    for row in rows:
        news = "-" if row.oldest_s is None else f"{row.oldest_s:.2f} s, of {row.oldest_of}"
        errors = ("-" if value is None else f"{value:.3f} m" for value in (row.formation_m, row.e_m))
        kept = [*errors, "yes" if row.settled else "no"] if placed else []
        table.add_row(str(row.vehicle), row.state, *kept, news)
    return table


def _links(rows: list[LinkRow]) -> Table:
    table = _table("link", "delivered", "lost", "share", "age")
    for row in rows:
        counts = str(row.delivered), str(row.lost), f"{100 * row.lost_share:.1f} %"
        table.add_row(row.link or f"{row.src}->{row.dst}", *counts, f"{row.age_s:.2f} s")
    return table


def _table(first: str, *others: str) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column(first, no_wrap=True)
    for heading in others:
        table.add_column(heading, justify="left" if heading == "state" else "right", no_wrap=True)
    return table
