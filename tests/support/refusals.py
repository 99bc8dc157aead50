"""What users are told of their mistakes: the mistakes and what comes of them stand in one golden file per room.

An entry of `tests/expected/messages-ROOM.txt` is the mistake (lines that begin with `>`), the class of its error with
every field (of a scenario: every place and key; of a command: the exit status), and the words. A new mistake is a line
with `>` in the file, or an item of the test. `WRITE_MESSAGES=1 pytest -n 0 FILE` then writes what comes of it, and new
words of the others. It never writes another class, place or field: who means that deletes those lines first.
"""

from __future__ import annotations

import ast
import os
import shlex
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from repository import EXPECTED
from tool import invoke

Entries = dict[tuple[str, ...], tuple[str, list[str]]]  # mistake: class with fields, words
_FIELDS_IN_WORDS = {"message", "hint", "reason", "lines", "problem", "problems"}
_LONG = 160  # characters of a mistake that are shown


class CommandRefused(Exception):
    """A command of `fleet` that ended with a status other than 0."""

    def __init__(self, status: int, said: str) -> None:
        super().__init__(said)
        self.status = status


def type_command(*arguments: str) -> None:
    """Call `fleet` in this process. What it says on standard error becomes one line.

    Raises:
        CommandRefused: It ended with a status other than 0.
    """
    done = invoke(*arguments)
    if done.exit_code:
        raise CommandRefused(done.exit_code, " ".join(done.stderr.split()))


def check_refusals(
    section: str, call: Callable[..., object], cases: Iterable[Any] | None = None, hide: Mapping[str, str] | None = None
) -> None:
    """Each mistake is refused as the golden file says, and its section has no others.

    Args:
        section: `room/what`, as in `scenario/small`.
        call: Called with each mistake; with its items if it is a tuple or a list.
        cases: The mistakes; by default the lines of the section, each with its items as texts.
        hide: Texts that are another on each machine or in each run, by what stands in their place.
    """
    room, _, what = section.partition("/")
    path = EXPECTED / f"messages-{room}.txt"
    sections = _read(path)
    known = sections.get(what, {})
    hide = {} if hide is None else hide  # which the call may fill
    replayed = (tuple(map(_literal, mistake)) for mistake in known)
    found = dict(_refusal(call, case, hide) for case in (replayed if cases is None else cases))
    if os.environ.get("WRITE_MESSAGES"):
        known = {case: (known.get(case, ("",))[0] or head, words) for case, (head, words) in found.items()}
        sections[what] = known
        path.write_text("\n".join(_printed(name, sections[name]) for name in sorted(sections)), "utf-8")
    nothing: tuple[str, list[str]] = ("nothing", [])
    pairs = {case: (known.get(case, nothing), found.get(case, nothing)) for case in (*known, *found)}
    moved = [f"{case}: expected {old[0]}, got {new[0]}" for case, (old, new) in pairs.items() if old[0] != new[0]]
    assert not moved, "\n".join(moved)
    other = [f"{case}: {new[1]}, before {old[1]}" for case, (old, new) in pairs.items() if old != new]
    assert not other, "\n".join(["if these words are meant: WRITE_MESSAGES=1 pytest -n 0 and this file", *other])


def words_of(section: str) -> dict[str, str]:
    """What is said of each mistake of a section, by the mistake."""
    room, _, what = section.partition("/")
    entries = _read(EXPECTED / f"messages-{room}.txt").get(what, {})
    return {" ".join(map(_literal, mistake)): "\n".join(words) for mistake, (_, words) in entries.items()}


def check_commands(section: str, places: Mapping[str, object], *before: str) -> None:
    """Likewise commands, each typed behind these words. Names in them stand for places, as in the words of errors."""
    hide = {str(place): name for name, place in sorted(places.items(), key=lambda item: -len(str(item[1])))}

    def typed(line: str) -> None:
        for place, name in hide.items():
            line = line.replace(name, place)
        type_command(*before, *shlex.split(line))

    check_refusals(section, typed, hide=hide)


def _refusal(
    call: Callable[..., object], case: Any, hide: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, list[str]]]:
    parts = case if isinstance(case, tuple | list) else (case,)
    try:
        call(*parts)
    except Exception as error:
        told = [*getattr(error, "problems", ()), getattr(error, "problem", None)]
        problems = [problem for problem in told if hasattr(problem, "message")]
        whose = [f"of {p.file}" for p in problems if len(parts) > 1]
        places = [f"{p.key or p.file}:{p.line}:{p.column}" for p in problems]
        held = getattr(error, "__dict__", {})  # an exception of a compiled module has none
        fields = {name: v for name, v in held.items() if name not in _FIELDS_IN_WORDS and v != ""}
        head = " ".join(
            [type(error).__name__, *places, *whose, *(f"{name}={v!s:.60}" for name, v in sorted(fields.items()))]
        )
        words = "\n".join(" ".join(filter(None, (p.message, p.hint))) for p in problems) or str(error)
        shown = [*map(_shown, parts), " ".join(head.split()), words]
        for before, after in hide.items():
            shown = [text.replace(before, after) for text in shown]
        return tuple(shown[:-2]), (shown[-2], [line for line in shown[-1].splitlines() if line.strip()])
    raise AssertionError(f"nobody refused {case!s:.200}")


def _shown(part: Any) -> str:
    """A part of a mistake on one line, the middle of a long one left out."""
    text = part if isinstance(part, str) and part.isprintable() and part == part.strip() else repr(part)
    return text if len(text) <= _LONG else f"{text[: _LONG // 2]} ... {text[-_LONG // 2 :]} ({len(text)})"


def _literal(part: str) -> str:
    """What was shown, where a text stands in quotes because it has line breaks, or blanks at its ends."""
    try:
        text = ast.literal_eval(part)
    except (ValueError, SyntaxError):
        return part
    return text if isinstance(text, str) and _shown(text) == part else part


def _read(path: Path) -> dict[str, Entries]:
    sections: dict[str, Entries] = {}
    for block in path.read_text("utf-8").strip("\n").split("\n\n") if path.exists() else ():
        lines = block.strip("\n").split("\n")
        if lines[0].startswith("## "):
            entries = sections.setdefault(lines[0][3:], {})
            continue
        mistake = tuple(line[2:] for line in lines if line.startswith(">"))
        head, *words = [*lines[len(mistake) :], ""]
        entries[mistake] = head, [line[2:] for line in words if line]
    return sections


def _printed(name: str, entries: Entries) -> str:
    blocks = [
        "\n".join([*(f"> {part}".rstrip() for part in mistake), head, *(f"  {line}" for line in words)])
        for mistake, (head, words) in entries.items()
    ]
    return "\n\n".join([f"## {name}", *blocks]) + "\n"
