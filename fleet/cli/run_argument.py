"""Which live run a command means, by position or by --run, and what the run answers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from fleet.cli import completion
from fleet.cli.completion import CLOCK_WORDS
from fleet.cli.group import USAGE

if TYPE_CHECKING:
    from fleet.execution.connection import LiveRun

F = TypeVar("F", bound=Callable[..., Any])
D = TypeVar("D")
_HELP = "The run: its name or the beginning of it, its scenario, or its directory. Needed if several live."
_TIMES = ("at", "for", "id")  # which may stand before the kind of a fault
_PACE = re.compile(r"max|[\d.]+x", re.ASCII)


def run_option(command: F) -> F:
    """Add the option that chooses a run."""
    return click.option("--run", "run", metavar="NAME", shell_complete=completion.runs, help=_HELP)(command)


def run_argument(command: F) -> F:
    """Add the option and an argument that choose a run."""

    @wraps(command)
    def with_run(*arguments: Any, name: str | None, run: str | None, **options: Any) -> Any:
        return command(*arguments, run=_one(name, run), **options)

    argument = click.argument("name", metavar="[RUN]", required=False, shell_complete=completion.runs, help=_HELP)
    return argument(run_option(with_run))  # type: ignore[return-value]


def _one(name: str | None, run: str | None) -> str | None:
    """The run by position and that of --run. Raises UsageError: they are two."""
    if name is not None and run is not None and name != run:
        raise click.UsageError(f"which run? {name}, or --run {run}: give one of them")
    return name if run is None else run


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


def fault_words(words: tuple[str, ...], run: str | None) -> tuple[str | None, str]:
    """The run that stands in front of a fault, if one does, and the fault.

    A kind of fault in front is no run, unless another kind stands behind it: `partition kill 3` kills an agent of the
    run `partition`.

    Args:
        words: as they were typed; the shell may have made one of several.
        run: that of --run.

    Raises:
        UsageError: the first word begins no fault, and no fault stands behind it.
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
    return run, text  # whose mistake is told when it is read


def clock_words(words: tuple[str, ...], run: str | None) -> tuple[str | None, str, str | None]:
    """The run, what its clock is to do, and how many ticks or how fast; `2x` is short for `speed 2`.

    Raises:
        UsageError: nothing of that.
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

    Raises:
        UsageError: more than two words, or two runs.
        RemoteError: there is no such run, or the word is the name of a run and a fault of the only one, too.
    """
    from fleet.execution.connection import RemoteError, ask, find, live_runs

    if len(words) > 2:
        raise click.UsageError(f"expected a run and the id of a fault at most, got {' '.join(words)}")
    if run is not None or len(words) != 1:
        name = _one(words[0], run) if len(words) == 2 else run
        return find(name), words[-1] if words else None
    (word,) = words
    try:
        named = find(word)
    except RemoteError as error:
        if error.status == USAGE or "/" in word:
            raise
        return find(), word
    if len(live_runs()) == 1 and any(fault["id"] == word for fault in ask(named, "faults")["faults"]):
        name = named.name
        both = f"fleet heal {name} (all its faults) or fleet heal {name} {word} (that one)"
        raise RemoteError(f"{word} is the run {name}, and a fault of it: say {both}", USAGE)
    return named, None
