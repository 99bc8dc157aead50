"""One line of several pieces, fitted to a width: the least important are shortened and left out first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten

GAP = "  "  # between pieces


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a line.

    Args:
        rank: 0 is the most important.
        forms: what it may read, the longest first; "" as the last: it may be left out.
    """

    rank: int
    forms: Sequence[str]


def fit(pieces: Sequence[Piece], width: int | None = None) -> str:
    """The pieces in their order, with GAP between them, in at most `width` characters.

    First it shortens and then drops optional pieces, beginning with the least important one, until the line fits. Then
    it shortens all other pieces step by step. Only if that is not enough, it drops these, too. Remaining room goes to
    the required pieces, then to as many optional ones as possible, by rank.

    `width`: in characters; None: no limit.
    """
    chosen = [piece.forms[0] for piece in pieces]
    if width is None:
        return _join_forms(chosen)

    def fits(k: int, form: str) -> bool:
        return len(_join_forms([*chosen[:k], form, *chosen[k + 1 :]])) <= width

    rising = sorted(range(len(pieces)), key=lambda k: pieces[k].rank)
    needed = [k for k in rising if pieces[k].forms[-1]]
    others = [k for k in rising if not pieces[k].forms[-1]]
    steps = [(k, form) for k in reversed(others) for form in pieces[k].forms]
    most = max((len(pieces[k].forms) for k in needed), default=0)
    steps += [(k, pieces[k].forms[n]) for n in range(most) for k in reversed(needed) if n < len(pieces[k].forms)]
    steps += [(k, "") for k in reversed(needed)]
    for k, form in steps:
        if len(_join_forms(chosen)) > width:
            chosen[k] = form
    for k in needed:
        chosen[k] = next(form for form in (*pieces[k].forms, chosen[k]) if fits(k, form))
    if all(chosen[k] for k in needed):
        for k in others:
            shortest = [form for form in pieces[k].forms if form][-1:]
            chosen[k] = next(form for form in (*shortest, chosen[k]) if fits(k, form))
        for k in others:
            chosen[k] = next(form for form in (*pieces[k].forms, chosen[k]) if fits(k, form))
    return _join_forms(chosen)


def shortened(text: str, *widths: int) -> list[str]:
    """The beginnings of a text, one per width, in whole words: forms of a piece."""
    return [shorten(text, width, placeholder=" ...") for width in widths]


def _join_forms(forms: Sequence[str]) -> str:
    return GAP.join(filter(None, forms))
