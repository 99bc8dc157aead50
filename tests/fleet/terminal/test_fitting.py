"""A line of pieces never exceeds the width, and what matters is there as long as there is any room for it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.terminal.line import GAP, Piece, fit, shortened

TIME = Piece(0, ["t = 1.0 / 60 s", "1.0/60 s"])
BAR = Piece(3, ["------------", "------", ""])
ERROR = Piece(1, ["formation error 1.000 m", "error 1.000 m"])
PACKETS = Piece(2, ["packets 10 delivered", "10 delivered", ""])
LINE = [TIME, BAR, ERROR, PACKETS]


@pytest.mark.parametrize(
    ("width", "shown"),
    [
        (None, "t = 1.0 / 60 s  ------------  formation error 1.000 m  packets 10 delivered"),
        (80, "t = 1.0 / 60 s  ------------  formation error 1.000 m  packets 10 delivered"),
        (74, "t = 1.0 / 60 s  ------  formation error 1.000 m  packets 10 delivered"),
        (68, "t = 1.0 / 60 s  ------------  formation error 1.000 m  10 delivered"),
        (66, "t = 1.0 / 60 s  ------  formation error 1.000 m  10 delivered"),
        (60, "t = 1.0 / 60 s  formation error 1.000 m  10 delivered"),
        (50, "t = 1.0 / 60 s  ------  formation error 1.000 m"),
        (40, "t = 1.0 / 60 s  formation error 1.000 m"),
        (36, "t = 1.0 / 60 s  error 1.000 m"),
        (23, "1.0/60 s  error 1.000 m"),
        (22, "t = 1.0 / 60 s"),
        (8, "1.0/60 s"),
        (7, ""),
        (0, ""),
    ],
)
def test_pieces_are_shortened_and_left_out_by_rank(width: int | None, shown: str) -> None:
    assert fit(LINE, width) == shown


def test_a_piece_that_says_nothing_takes_no_room() -> None:
    assert fit([TIME, Piece(1, [""]), ERROR], 80) == "t = 1.0 / 60 s  formation error 1.000 m"


def test_shortened_text_ends_at_a_word() -> None:
    waiting = "waiting for agent 3 (pid 12 is suspended), 4 s"
    assert shortened(waiting, 60, 30, 11) == [waiting, "waiting for agent 3 (pid ...", "waiting ..."]
    assert shortened("", 30) == [""]


def forms(least: int) -> st.SearchStrategy[list[str]]:
    lengths = st.lists(st.integers(1, 40), min_size=1, max_size=4)
    return lengths.map(lambda some: ["x" * n for n in sorted(some, reverse=True)] + [""] * (1 - least))


pieces = st.lists(
    st.tuples(st.booleans(), st.integers(0, 9)).flatmap(
        lambda kind: forms(int(kind[0])).map(lambda some: Piece(kind[1] if kind[0] else 10 + kind[1], some))
    ),
    max_size=8,
)


@given(pieces, st.integers(0, 120))
def test_a_line_is_never_too_wide_and_keeps_what_matters(some: list[Piece], width: int) -> None:
    line = fit(some, width)
    assert len(line) <= width
    needed = [piece.forms[-1] for piece in some if piece.forms[-1]]
    if len(GAP.join(needed)) <= width:
        assert len(list(filter(None, line.split(GAP)))) >= len(needed)
    whole = GAP.join(filter(None, (piece.forms[0] for piece in some)))
    assert fit(some, len(whole)) == whole == fit(some)
