"""Whether the library can be preloaded into an executable: what it is not loaded into would escape, unseen."""

from __future__ import annotations

import os
import shutil
import struct
from pathlib import Path

WALL_CLOCK = "it runs on the wall clock: fleet netem"
_MOST = 4096  # bytes of the beginning of a file in which its kind stands
_DEEPEST = 4  # interpreters of interpreters
_INTERPRETER, _NOTE = 3, 4  # kinds of parts of an ELF file


def obstacle(path: str | Path) -> str:
    """Why an executable cannot run in simulated time.

    Args:
        path: of the file, or the name of a command.

    Returns:
        The reason, for a sentence; "": it can.
    """
    name = str(path)
    for _ in range(_DEEPEST):
        found = name if "/" in name else shutil.which(name)
        if found is None:
            return f"there is no command {name!r}"
        try:
            status = os.stat(found)
            with open(found, "rb") as file:
                head = file.read(_MOST)
        except OSError as error:
            return f"{found} cannot be read: {error.strerror}"
        if status.st_mode & 0o6000 and status.st_uid != os.getuid():
            return f"{found} runs with the rights of its owner, and then nothing can be preloaded; {WALL_CLOCK}"
        if not head.startswith(b"#!"):
            return _binary_problem(found, head)
        words = head[2:].split(b"\n", 1)[0].split()
        if not words:
            return ""
        name = os.fsdecode(words[0])
        if name.endswith("/env") and len(words) > 1:
            name = os.fsdecode(
                next((word for word in words[1:] if not word.startswith(b"-") and b"=" not in word), b"sh")
            )
    return ""


def _binary_problem(found: str, head: bytes) -> str:
    if not head.startswith(b"\x7fELF"):
        return "" if head[:1].isascii() else f"{found} is no program that Linux executes"
    if len(head) < 64 or head[4] != 2 or head[18:20] != b"\x3e\x00":
        return f"{found} is no program for x86-64; {WALL_CLOCK}"
    (offset,), (size, count) = struct.unpack_from("<Q", head, 32), struct.unpack_from("<HH", head, 54)
    dynamic = False
    for place in range(offset, min(offset + size * count, len(head) - 56), size or 56):
        kind, _, start, _, _, size_of_part = struct.unpack_from("<IIQQQQ", head, place)
        dynamic |= kind == _INTERPRETER
        if kind == _NOTE and b"Go\0\0" in head[start : start + size_of_part]:
            return f"{found} is a program of Go, whose threads have stacks on which no trap fits; {WALL_CLOCK}"
    return "" if dynamic else f"{found} is a static program, into which nothing can be preloaded; {WALL_CLOCK}"
