"""The group of all commands, each imported when it is asked for.

An error ends a command with one line on stderr and with the status of the error.
"""

from __future__ import annotations

import errno
import os
import re
import shlex
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from typing import Any

import click

from fleet.addon import Verb, installed_addons, load
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.cli.verbs import every_verb, headings, hint_for, other_option, verb_of
from fleet.errors import FleetError, describe_error, harmless
from fleet.terminal.output import OutputError
from fleet.terminal.width import say
from netem.errors import NetemError

EPILOG = (
    "Exit status: 0 pass, 1 a check failed, 2 usage or bad scenario, 3 the run broke, 129 terminal closed, 130 Ctrl-C."
)
USAGE = 2
WHOLE = 500  # characters; no first sentence of a command is that long
BROKEN = 3  # the exit status of an error that has none of its own: those of the network


class ListingGroup(click.Group):
    """A group whose help has the whole first sentence of each command; click would cut it."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that the user typed.

        If there is none of that name, the error lists all commands. Raises UsageError.
        """
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            from netem.parsing import quoted  # here, for commands start without it

            names = self.list_commands(ctx)
            raise click.UsageError(f"{ctx.command_path} has no {quoted(args[0])}; expected {', '.join(names)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of the commands."""
        found = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        rows = [(name, command.get_short_help_str(WHOLE)) for name, command in found if command and not command.hidden]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


_TYPED = "fleet.typed"


def typed_command(without: str) -> str:
    """The command line that was typed, as one for a shell; of a command that is called from Python, its name.

    Args:
        without: an option with a value that is left out, such as `--junit`.
    """
    context = click.get_current_context()
    typed = context.meta.get(_TYPED)
    if typed is None:
        return context.command_path
    kept, words = [], iter(typed)
    for word in words:
        if word == without:
            next(words, None)  # its value
        elif not word.startswith(f"{without}="):
            kept.append(word)
    return f"fleet {shlex.join(kept)}"


class FleetGroup(click.Group):
    """The group of all commands: it imports only the one in use, and prints the errors that commands raise."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """The context of a command line, which remembers what was typed."""
        typed = [*args]
        context = super().make_context(info_name, args, parent, **extra)
        context.meta[_TYPED] = typed
        return context

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands, in the order of the help."""
        return list(every_verb())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name; None: there is none."""
        verb = verb_of(cmd_name)
        return super().get_command(ctx, cmd_name) if verb is None else _load(cmd_name, verb)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that was typed; for one of another tool the error names ours. Raises UsageError."""
        if args == ["help"]:
            click.echo(ctx.get_help())
            ctx.exit()
        if args and args[0] == "help":
            args = [args[1], "--help"]
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            from netem.parsing import nearest, quoted  # here, for commands start without it

            ours = hint_for(args[0])
            hint = f"; use {ours}" if ours else f"; {nearest(args[0], every_verb()) or 'fleet --help lists them'}"
            raise click.UsageError(f"there is no command {quoted(args[0])}{hint}{_left_out()}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in their groups, without importing them."""
        wide = max(map(len, every_verb()))
        for title, verbs in headings().items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(wide), verb.help) for name, verb in verbs.items()])

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; an error of this package becomes a line on stderr and an exit status.

        With `--json` an error is also the document that the command prints.
        """
        try:
            return super().invoke(ctx)
        except click.ClickException as error:  # click prints it
            # `message` is final for those who inherit from it.
            error.message = harmless(error.message + _hint(error))  # type: ignore[misc]
            _document(error, error.format_message(), error.exit_code)
            raise
        except (FleetError, NetemError, OSError, UnicodeEncodeError) as error:
            status = report(error)
            _document(error, _words(error), status)
            ctx.exit(status)
        except (click.exceptions.Exit, click.Abort, ImportError, MemoryError, OutputError):
            raise  # they have meanings of their own
        except Exception as error:
            traceback.print_exc()
            words = f"{describe_error(error)}: {_who_mends(ctx.invoked_subcommand or '')}"
            say(f"fleet: {words}", err=True)
            _document(error, words, BROKEN)
            ctx.exit(BROKEN)  # Python's own 1 would say that a check failed


def _who_mends(name: str) -> str:
    """Who has to mend what a command does by mistake."""
    verb = verb_of(name)
    package = "fleet" if verb is None else verb.command.partition(":")[0].partition(".")[0]
    if package != "fleet":
        return f"a mistake in fleet {name}, which the add-on {package} brings; the lines above say where"
    return "a mistake of ours; please report the lines above, and what fleet about prints"


def _hint(error: click.ClickException) -> str:
    """A hint at what the user probably meant; empty: there is none."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is None:
        return ""
    if isinstance(error, click.NoSuchOption):
        other = other_option(context.info_name or "", error.option_name)
        if other or installed_addons().left_out:
            error.possibilities = []  # type: ignore[misc]
        return f" {other}" if other else _left_out()
    change = _CHANGE.search(error.message)
    if change is None or not any("--set" in parameter.opts for parameter in context.command.params):
        return ""
    return f": a change of the scenario is --set '{change[1]}'"


def command_of(name: str) -> click.Command:
    """The command of a name that `every_verb` has."""
    return _load(name, every_verb()[name])


def _load(name: str, verb: Verb) -> click.Command:
    try:
        found = load(verb.command)
    except (Exception, SystemExit) as error:
        raise FleetError(f"fleet {name} cannot be loaded: {verb.command}: {describe_error(error)}") from error
    if not isinstance(found, click.Command):
        raise FleetError(f"the add-on that brings fleet {name} gives {found!r:.80} in place of a click command")
    return found


def _left_out() -> str:
    """The add-ons that this environment has and that cannot be used, with the reason of the first."""
    found = installed_addons()
    if found.left_out:
        return f"\nadd-ons that are left out: {', '.join(found.left_out)} ({next(iter(found.left_out.values()))})"
    hint = "\nno add-on is registered in this environment; in a checkout `pip install -e .` registers ours"
    return "" if found.addons else hint


_CHANGE = re.compile(r"unexpected extra arguments? \(([\w.*>-]+=[^)]*)\)")
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
_SQLITE_FULL, _SQLITE_IOERR = 13, 10  # codes of SQLite: importing sqlite3 for them would take longer


def report(error: Exception) -> int:
    """Print an error on stderr, and return the exit status that belongs to it."""
    say(f"fleet: {_words(error)}", err=True)
    if not _has_folder():
        say("       the folder that you are in has been removed: go to another one", err=True)
    if _no_room(error):
        return BROKEN
    match error:
        case OSError(filename=str() | bytes() | PathLike()) | UnicodeEncodeError():
            return USAGE  # about what was asked for
        case _:
            return int(getattr(error, "status", BROKEN))


def _has_folder() -> bool:
    """Whether the working directory exists."""
    try:
        return bool(os.getcwd())
    except OSError:
        return False


def _no_room(error: BaseException | None) -> bool:
    """Whether a full disk, or one that fails, is behind an error: any other place would do as badly."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            return True
        if getattr(error, "sqlite_errorcode", None) in (_SQLITE_FULL, _SQLITE_IOERR):
            return True
        error = error.__cause__ or error.__context__
    return False


def _words(error: Exception) -> str:
    match error:
        case OSError():  # a place that no command words by itself, as with a name that is too long
            return f"{'' if error.filename is None else f'{error.filename}: '}{error.strerror or error}"
        case UnicodeEncodeError():  # an argument has bytes that are no text
            return f"{error.object[:80]!r} is not UTF-8 text"
        case _:
            return str(error)


def _document(error: Exception, message: str, status: int) -> None:
    if json_is_asked():
        from fleet.cli.documents.failure import failure

        print_document(failure(error, message, status))


@contextmanager
def exit_status(status: int) -> Iterator[None]:
    """Set the exit status of every error of this package that is raised inside."""
    try:
        yield
    except (FleetError, NetemError) as error:
        error.status = status  # type: ignore[union-attr]
        raise
