"""`fleet` and `python -m fleet`: the command line, if its packages are those of this distribution."""

from __future__ import annotations

import gc
import os
import signal
import sys
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import FrameType
from typing import Any

from fleet.processes.interrupts import ENDING, ending, ending_status
from fleet.terminal.output import OutputError, give_up_output, open_streams

# Net new objects between two collections. Most of what a command makes at first, modules and classes, stays: Python's
# own 700 let the collector walk through it again and again, for a sixth of the time of a short run.
COLLECT_EVERY = 200_000
CANNOT_RUN = 3  # the exit status when packages of ours were replaced, or cannot be loaded
READER_GONE = 128 + signal.SIGPIPE  # what a shell shows for `seq 99999 | head -1`
OURS = "uuv-fleet"
# The packages that other distributions may replace, and how the docstrings of ours begin.
_BEGINS = {"agents": b'"""Agents: ', "world": b'"""The sea: ', "netem": b'"""The network: '}
_DO = f"install {OURS} into an environment of its own: uv tool install, or pipx install"


def main() -> None:
    """The console script: the command line, with Ctrl-C, SIGTERM and SIGHUP as a clean end."""
    gc.set_threshold(COLLECT_EVERY)
    # One thread per process, or each numpy spins a thread per core as it starts, for half of its time to import.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_streams()
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as `nohup` leaves it
            signal.signal(number, _interrupt)
    status = 0
    try:
        status = _command_line()
        sys.stdout.flush()
    except KeyboardInterrupt as error:
        status = ending_status(error)
    except OutputError as error:
        # The reader of our output, `head` for instance, has seen enough: that needs no word.
        status = READER_GONE if error.reader_gone else error.status
        if not error.reader_gone:
            sys.stderr.write(f"fleet: {error}\n")
        give_up_output()
    gc.freeze()  # otherwise Python's end would collect again, and walk through everything for a tenth of a second
    # From here on Python would print what a handler raises.
    for number in ENDING:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN if _interrupted else signal.SIG_DFL)
    sys.exit(status)


def _command_line() -> int:
    """The exit status of what was asked for."""
    if text := foreign():
        return _cannot_run(text)
    import click

    try:
        from fleet.cli.main import cli

        status = cli(standalone_mode=False)
    except ImportError as error:
        if text := damaged_package(error):
            return _cannot_run(text)
        if isinstance(error, ModuleNotFoundError):
            raise
        return _cannot_run(f"{error}; is there enough memory to load it?")
    except MemoryError:
        return _cannot_run("there is not enough memory")
    except click.Abort as abort:
        return ending_status(abort.__cause__)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        return end.code or 0
    return status if isinstance(status, int) else 0


def _cannot_run(text: str) -> int:
    sys.stderr.write(f"fleet: {text}\n")
    return CANNOT_RUN


_interrupted = False


def _interrupt(number: int, _: FrameType | None) -> None:
    global _interrupted
    if _interrupted:  # once is enough: ending the processes takes a moment, and a second one would cut that short
        return
    _interrupted = True
    raise ending(number)


def foreign() -> str:
    """Look for a package that another distribution has replaced.

    A distribution that brings a package of the same name, as `agents` 1.4.0 and `world` 5.2.1 of PyPI do, overwrites
    files of ours, or is found before ours. Only the first line of each package is read, so that no foreign code runs.

    To install ours below one namespace was rejected: the names are in every protocol of a user, in the texts
    `module:Class` of scenarios and logs, and in the commands that start processes.

    Returns:
        One line that names the package, its distribution and the remedy; "" if all packages are ours.
    """
    for name, begin in _BEGINS.items():
        spec = find_spec(name)
        if spec is None or not _begins(spec, begin):
            return f"the package {name}{_place(spec)} is {_owner(name)}; {_DO}"
    return ""


def damaged_package(error: ImportError) -> str:
    """The same of an import that failed within one of the packages, compiled or not; "" if it was another import."""
    name = (error.name or "").partition(".")[0]
    if name.endswith("__mypyc"):
        return f"the compiled cores cannot be loaded: {error}; install {OURS} here, or with UUV_FLEET_COMPILE=no"
    if name not in _BEGINS:
        return ""
    return f"the package {name}{_place(find_spec(name))} is {_owner(name)}: {error}; {_DO}"


def _begins(spec: ModuleSpec, begin: bytes) -> bool:
    loader: Any = spec.loader  # the loader of a file or of a zip file
    if spec.origin is None or not hasattr(loader, "get_data"):
        return False  # a folder without __init__.py, for instance
    if not spec.origin.endswith(".py"):
        return True  # only compiled, so there is no text to read
    return bool(loader.get_data(spec.origin).startswith(begin))


def _place(spec: ModuleSpec | None) -> str:
    places = list(spec.submodule_search_locations or []) if spec is not None else []
    return f" in {places[0]}" if places else ""


def _owner(name: str) -> str:
    """The installer of the package, in words."""
    from importlib.metadata import packages_distributions

    others = sorted(set(packages_distributions().get(name, [])) - {OURS})
    return f"that of {' and '.join(others)}, or mixed with it" if others else f"not that of {OURS}, or not whole"


if __name__ == "__main__":
    main()
