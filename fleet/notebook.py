"""Tables and pictures for notebooks: what `_repr_html_` of a result, a log, a study or its pictures returns."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

MOST_ROWS = 60
_SHOWN = {".png": "image/png", ".svg": "image/svg+xml"}


class Pictures(list[Path]):
    """The files of pictures, which a notebook shows."""

    def _repr_html_(self) -> str:
        return "\n".join(
            f'<img alt="{escape(path.name)}" src="data:{kind};base64,{b64encode(path.read_bytes()).decode()}">'
            for path in self
            if (kind := _SHOWN.get(path.suffix)) and path.exists()
        )


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
