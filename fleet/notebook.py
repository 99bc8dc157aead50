"""Tables and pictures for notebooks: what `_repr_html_` of a result, a log, a study or its pictures returns."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 60
DPI = 110


class Pictures(dict[str, "Figure"]):
    """Figures of matplotlib by the names of their pictures, to change and save; a notebook shows them."""

    def _repr_html_(self) -> str:
        return "\n".join(
            f'<img alt="{escape(name)}" src="data:image/png;base64,{b64encode(_png(figure)).decode()}">'
            for name, figure in self.items()
        )


def _png(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()


def html_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in HTML; every cell is shown as text, and rows beyond the first 60 are counted."""
    body = [[escape(str(cell)) for cell in row] for row in rows]
    lines = [f"<table><caption>{escape(title)}</caption>", _row("th", map(escape, headings))]
    lines += [_row("td", row) for row in body[:MOST_ROWS]]
    if len(body) > MOST_ROWS:
        lines.append(f'<tr><td colspan="{len(headings)}">and {len(body) - MOST_ROWS} more</td></tr>')
    return "\n".join([*lines, "</table>"])


def _row(tag: str, cells: Iterable[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in cells) + "</tr>"
