"""Programs of ours that run beside the user's, in the same simulated time and on the same host."""

from __future__ import annotations

import sys
from pathlib import Path

import fleet

_BEGIN = "import runpy, sys; sys.path.insert(0, sys.argv.pop(1)); runpy.run_module(sys.argv.pop(1), None, '__main__')"


def helper_command(module: str, *arguments: object) -> list[str]:
    """The command line of a module of ours as a program."""
    root = Path(fleet.__file__).parents[1]
    return [own_python(), "-P", "-c", _BEGIN, str(root), module, *map(str, arguments)]


def own_python() -> str:
    """This Python, by one name: `sys.executable` has the name by which a process was started, `python` or `python3`.

    A name of another length moves what the program has in its memory, and so the order of its sets.
    """
    own = Path(sys.prefix, "bin", f"python{sys.version_info.major}")
    return str(own) if own.is_file() else sys.executable
