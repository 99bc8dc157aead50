"""Which line of the user's an error is about, and its text: for messages about the user's code."""

from __future__ import annotations

import inspect
import os
import sysconfig
import traceback
from pathlib import Path
from typing import Any

import world

_MAX_TEXT = 300  # characters of the text of an error
_LIBRARIES = tuple({sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_PACKAGES = {Path(world.__file__).parent.with_name(name) for name in ("world", "agents", "fleet")}
_SITE = "-packages" + os.sep  # site-packages, and Debian's dist-packages


def place_of(error: BaseException) -> str:
    """`file.py:12`: the innermost line of an error that the user can have written.

    A line of a library, the standard one or an installed one, is the answer only if there is no other: what raised
    inside numpy was called from somewhere.
    """
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _ours(f.filename)]
    own = [f for f in frames if not is_in_library(f.filename)]
    if not own:  # an installed plug-in: its file is the first that was called
        installed = [f for f in frames if _SITE in f.filename] or frames
        own = [f for f in frames if f.filename == installed[0].filename]
    return place_of_line(own[-1].filename, own[-1].lineno) if own else ""


def is_in_library(filename: str) -> bool:
    """Whether a file belongs to the standard library or to an installed package."""
    return filename.startswith(_LIBRARIES) or filename.startswith("<frozen")


def words_of(error: BaseException) -> str:
    """`ValueError: its text`, on one line of at most 300 characters."""
    try:
        # A SyntaxError's own text ends with its place, which messages have beside it.
        text = " ".join(((error.msg or "") if isinstance(error, SyntaxError) else str(error)).split())
    except Exception:  # the error's __str__ is the user's, too
        text = "(it cannot be printed)"
    text = text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place_of_line(filename: str, line: int | None) -> str:
    """`file.py:12`, relative to the current directory where it lies below it."""
    return f"{shown_path(filename)}:{line}"


def place_of_method(method: Any) -> str:
    """`file.py:12`: where a method, or the making of a class, begins."""
    code = getattr(method.__init__ if inspect.isclass(method) else method, "__code__", None)
    return "" if code is None else place_of_line(code.co_filename, code.co_firstlineno)


def _ours(filename: str) -> bool:
    return bool(_PACKAGES.intersection(Path(filename).parents)) or filename.startswith("<frozen importlib")


def shown_path(filename: str) -> str:
    """A path as messages show it: relative to the current directory where it lies below it."""
    relative = os.path.relpath(filename)
    return filename if relative.startswith("..") else relative
