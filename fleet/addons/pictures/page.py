"""The pages of `fleet report`: what they share, pictures within the file, and written whole or not at all."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from fleet.addons.pictures.look import COLUMN_IN
from fleet.addons.pictures.style import DPI
from fleet.errors import FleetError
from netem.whole_file import whole_file


class Heading(NamedTuple):
    """A heading; `anchor` is where links lead."""

    text: str
    level: int = 3
    anchor: str = ""


class Paragraph(NamedTuple):
    """A paragraph, in which a command stands between backticks; `kind` is `warn`, `verdict` or neither."""

    text: str
    kind: str = ""


class Contents(NamedTuple):
    """Links within the page: anchor, name, and what stands behind it."""

    entries: list[tuple[str, str, str]]


class Mark(NamedTuple):
    """A word in the colour of a pass or of a failure."""

    good: bool
    word: str


class Table(NamedTuple):
    """Rows under headings, or without any; a cell is a `Mark`, or is shown as text."""

    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]
    kind: str = ""  # `words`, `numbers`, `last` (which is words) or nothing


class FoldedText(NamedTuple):
    """Text as it is, folded away if it has a title."""

    text: str
    title: str = ""


class PageImage(NamedTuple):
    """One picture of the page; `png` in base 64."""

    title: str
    png: str
    wide: bool = False  # it is wider than a column


class SectionImages(NamedTuple):
    """The pictures of a section, and what could not be drawn, with the reason."""

    drawn: list[PageImage]
    missing: list[str]


Block = Heading | Paragraph | Contents | Mark | Table | PageImage | SectionImages | FoldedText


def from_here(path: Path) -> Path:
    """A path for the reader of a page: from the folder in which the page is made, if it lies below that. A page for
    others need not tell where this user keeps files."""
    found = path.resolve()
    return found.relative_to(Path.cwd()) if found.is_relative_to(Path.cwd()) else found


def check_place(path: Path, *, force: bool) -> None:
    """Refuse a place that holds a file already. `force`: whether it shall be replaced. Raises FleetError if there is a
    file.
    """
    if path.is_file() and not force:
        raise FleetError(f"{path} already exists; choose another place with -o FILE, or replace it with --force")


def write_page(path: Path, make: Callable[[], str]) -> None:
    """Write the page that `make` returns. Raises FleetError: the place cannot be written."""
    try:
        with whole_file(path) as part:
            part.open("a").close()  # before the pictures, which take a while
            part.write_text(make(), "utf-8", errors="replace")  # of a name that is no text
    except OSError as error:
        raise FleetError(f"cannot write {path}: {error.strerror}; choose another place with -o FILE") from error


def render(title: str, blocks: Sequence[Block], conventions: str = "") -> str:
    """A page as HTML; every value is escaped."""
    # Here, since every command that draws would pay for the import.
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    template = environment.from_string(files("fleet.addons.pictures").joinpath("page.html").read_text("utf-8"))
    return template.render(
        title=title,
        blocks=[(type(block).__name__, block) for block in blocks],
        conventions=conventions,
        version=version("uuv-fleet"),
    )


def images(
    drawn: Iterable[tuple[str, str, Figure | str]], first: Sequence[str] | None = None
) -> tuple[PageImage | None, SectionImages]:
    """The first picture of those names that is drawn, of any name if None, and all others with what is missing.
    `drawn`: name, title, and the picture or why there is none.
    """
    found, missing = dict[str, PageImage](), []
    for name, title, figure in drawn:
        if isinstance(figure, str):
            missing.append(f"{name}: {figure}")
        else:
            found[name] = PageImage(title, png(figure), figure.get_figwidth() > COLUMN_IN)
    top = next((found.pop(name) for name in (list(found) if first is None else first) if name in found), None)
    return top, SectionImages(list(found.values()), missing)


def png(figure: Figure) -> str:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return base64.b64encode(file.getvalue()).decode("ascii")
