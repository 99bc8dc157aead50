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

from fleet.errors import FleetError
from fleet.pictures.style import COLUMN_IN, DPI
from netem.private_file import whole_file

_SHARED = ("page.html", "parts.html")


class PageImage(NamedTuple):
    """One picture of the page; `png` in base 64."""

    title: str
    png: str
    wide: bool = False  # it is wider than a column


class SectionImages(NamedTuple):
    """The pictures of a section, and what could not be drawn, with the reason."""

    drawn: list[PageImage]
    missing: list[str]


def check_place(path: Path, *, force: bool) -> None:
    """Refuse a place that holds a file already.

    Args:
        force: whether it shall be replaced.

    Raises:
        FleetError: there is a file.
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


def render(room: str, template: str, **values: Any) -> str:
    """A page as HTML; every value is escaped.

    Args:
        room: the package that holds the template.
        template: its file.
        values: what it shows, and `title`.
    """
    # Here, since every command that draws would pay for the import.
    from jinja2 import DictLoader, Environment, StrictUndefined

    texts = {name: files("fleet.pictures").joinpath(name).read_text("utf-8") for name in _SHARED}
    texts[template] = files(room).joinpath(template).read_text("utf-8")
    environment = Environment(
        loader=DictLoader(texts),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(version=version("uuv-fleet"), **values)


def images(
    drawn: Iterable[tuple[str, str, Figure | str]], first: Sequence[str] | None = None
) -> tuple[PageImage | None, SectionImages]:
    """The first picture of those names that is drawn, of any name if None, and all others with what is missing.

    Args:
        drawn: name, title, and the picture or why there is none.
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
    """A figure as PNG in base 64."""
    file = BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return base64.b64encode(file.getvalue()).decode("ascii")
