"""The lessons of docs/learn as cells, and as notebooks for Jupyter: `python docs/notebooks.py lessons`.

The Markdown pages are the source. Boxes of a page are read like this:

* `sh`: commands. If the first line is `# in another terminal`, they run on while the lesson continues.
* `python` and `yaml` with a first line such as `# buddy.py`: a file that the reader writes.
* `python` without it: code that the reader runs.
* `text` directly below one of these: its output. `...` stands for anything.

tests/house/test_lessons.py executes the same cells, and the site offers the same notebooks.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

LEARN = Path(__file__).resolve().parent / "learn"
BACKGROUND = "# in another terminal"
BOX = re.compile(r"^```(sh|python|yaml|text)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# ([\w.-]+\.(?:py|yaml|csv))\n")
RELATIVE = re.compile(r"(?<=\]\()(?!https?:|#)([^)\s]+)(?=\))")


class Cell(NamedTuple):
    """A piece of a lesson."""

    kind: str  # words, commands, background, file, or code
    text: str
    shown: str = ""  # the output as the lesson shows it
    line: int = 0  # of the page, where the box begins

    @property
    def name(self) -> str:
        """The name of the file that the reader writes."""
        match = FILE.match(self.text)
        return match[1] if match else ""


def lessons() -> list[Path]:
    """The pages of the lessons, in their order."""
    pages = [path for path in LEARN.glob("*.md") if path.stem != "index"]
    return sorted(pages, key=lambda path: int(path.stem.partition("-")[0]))


def cells(page: Path) -> list[Cell]:
    """A lesson as cells, in their order."""
    text, end = page.read_text("utf-8"), 0
    found: list[Cell] = []
    for box in BOX.finditer(text):
        words = text[end : box.start()].strip()
        end = box.end()
        if words:
            found.append(Cell("words", words))
        if box[1] == "text" and not words and found and not found[-1].shown:
            found[-1] = found[-1]._replace(shown=box[2])
        else:
            found.append(Cell(_kind(box[1], box[2]), box[2], line=text.count("\n", 0, box.start()) + 1))
    return [*found, Cell("words", text[end:].strip())]


def _kind(language: str, text: str) -> str:
    if language == "sh":
        return "background" if text.startswith(BACKGROUND) else "commands"
    if language == "text":
        return "words"
    return "file" if FILE.match(text) else "code"


def notebook(page: Path, link: Callable[[str], str]) -> dict[str, Any]:
    """A lesson as a notebook of Jupyter.

    Commands are cells of bash. A failed check, which exits with 1, does not stop the notebook.

    Args:
        link: where a link of the page leads in the notebook.
    """
    made = [_made(number, cell, link) for number, cell in enumerate(cells(page))]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def _made(number: int, cell: Cell, link: Callable[[str], str]) -> dict[str, Any]:
    common: dict[str, Any] = {"id": f"cell-{number}", "metadata": {}}
    if cell.kind == "words":
        linked = RELATIVE.sub(lambda found: link(found[1]), cell.text)
        return common | {"cell_type": "markdown", "source": linked or "(no text)"}
    magic = {
        "commands": "%%bash --no-raise-error\n",
        "background": "%%bash --bg\n",
        "file": f"%%writefile {cell.name}\n",
        "code": "",
    }[cell.kind]
    shown = [{"output_type": "stream", "name": "stdout", "text": cell.shown}] if cell.shown else []
    source = magic + cell.text.rstrip("\n")
    return common | {"cell_type": "code", "source": source, "execution_count": None, "outputs": shown}


def write(folder: Path, *, pages_end: str = "") -> Iterator[Path]:
    """Write a notebook per lesson into a folder; yields their paths.

    Args:
        pages_end: of links to pages if the folder is that of the lessons in the site; by default they lead to docs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    there = folder.resolve()
    for page in lessons():

        def link(target: str) -> str:
            return target.replace(".md", pages_end) if pages_end else os.path.relpath(LEARN / target, there)

        path = folder / f"{page.stem}.ipynb"
        path.write_text(json.dumps(notebook(page, link), indent=1, ensure_ascii=False) + "\n", "utf-8")
        yield path


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        raise SystemExit(f"usage: {sys.argv[0]} FOLDER    writes the lessons of docs/learn there, as notebooks")
    for made in write(Path(sys.argv[1])):
        print(made)
