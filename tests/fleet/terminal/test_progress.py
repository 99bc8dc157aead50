"""One status line for every kind of progress, on a terminal and elsewhere."""

from __future__ import annotations

import io
from functools import partial

import pytest
from rich.console import Console as Terminal

from fleet.terminal import status_line
from fleet.terminal.progress import showing_jobs
from fleet.terminal.status_line import BAR, StatusLine, bar


def terminal(*, live: bool) -> tuple[Terminal, io.StringIO]:
    out = io.StringIO()
    return Terminal(file=out, force_terminal=live, width=60), out


def test_a_terminal_is_rewritten_and_left_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status_line, "REFRESH_S", 0.0)
    on, out = terminal(live=True)
    with StatusLine(on, quiet=False) as line:
        assert line.live and line.due()
        line.show("one")
        line.print("waiting for agent 3")  # a line that stays is not written into the status
        line.show("x" * 100)
    assert out.getvalue() == f"\rone\x1b[K\r\x1b[Kwaiting for agent 3\n\r{'x' * 59}\x1b[K\r\x1b[K"


def test_elsewhere_a_line_comes_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    on, out = terminal(live=False)
    with StatusLine(on, quiet=False) as line:
        assert not line.due()
        line.show("too early")
    assert out.getvalue() == ""
    monkeypatch.setattr(status_line, "PLAIN_S", 0.0)
    with showing_jobs(on) as report:
        report("drawing", 0.5)
    assert out.getvalue() == " 50%  drawing\n"


def test_elsewhere_long_work_has_a_line_ever_more_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each five seconds a line: a study of an hour left 720 of them in the log of a CI service."""
    now = 0.0
    monkeypatch.setattr(status_line.time, "monotonic", lambda: now)
    on, out = terminal(live=False)
    with StatusLine(on, quiet=False) as line:
        for now in range(3601):
            line.update(partial("{} s".format, now))
    times = [int(text.split()[0]) for text in out.getvalue().splitlines()]
    assert times[:4] == [5, 10, 15, 20] and times[-1] > 3000 and len(times) < 60


def test_colours_in_a_file_are_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jupyter and many CI services set FORCE_COLOR. A line that rewrites itself fills their logs."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    out = io.StringIO()
    on = Terminal(file=out, width=60)
    assert on.is_terminal
    with StatusLine(on, quiet=False, first_s=0.0) as line:
        assert not line.live
        line.show("one")
    assert out.getvalue() == "one\n"


def test_quiet_shows_nothing() -> None:
    on, out = terminal(live=True)
    with StatusLine(on, quiet=True) as line:
        line.show("one")
        line.print("two")
        assert not line.due()
    assert out.getvalue() == ""


@pytest.mark.parametrize(("share", "done"), [(-1.0, 0), (0.0, 0), (0.5, BAR // 2), (1.0, BAR), (2.0, BAR)])
def test_a_bar_has_its_length_whatever_the_share(share: float, done: int) -> None:
    assert (bar(share).count("━"), len(bar(share))) == (done, BAR)
