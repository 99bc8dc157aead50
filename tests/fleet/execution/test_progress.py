"""The progress line of a run at several widths, against tests/expected/screen-progress.txt."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console as Terminal
from screens import assert_screen
from small_scenario import small

from fleet.execution import progress
from fleet.execution.progress import ProgressLine
from fleet.result.result import Formation
from fleet.terminal.status_line import StatusLine
from netem.cause import Cause
from netem.ledger import Account

OF_FLEET = Formation(12.345, 4, 11.5, 4)
LOSSES = {Cause.LOSS: 123, Cause.REPLACED: 7}
MANY = ["nemesis-1", "storm", "split", "gust", "live-1", "live-2"]
SUSPENDED = "waiting for agent 3 (pid 12345 is suspended), 12 s"
STATES: dict[str, dict[str, Any]] = {
    "one vehicle": {"metrics": SimpleNamespace(formation=Formation(0.5, 1))},
    "four vehicles": {},
    "a fault": {"active": ["nemesis-1"]},
    "many faults": {"active": MANY},
    "tumbled": {"tumbled": dict.fromkeys([3, 2]), "diverged": dict.fromkeys([4])},
    "many tumbled": {"active": ["nemesis-1"], "tumbled": dict.fromkeys(range(1, 8))},
    "waiting": {"waiting": SUSPENDED},
    "everything": {"active": MANY, "waiting": SUSPENDED},
}


def journal(**state: Any) -> Any:
    total = Account(delivered=123456, lost=dict(LOSSES))
    ledger = SimpleNamespace(total=lambda: total)
    metrics = SimpleNamespace(formation=OF_FLEET)
    common = {
        "begin": 0,
        "written": 6000,
        "active": [],
        "tumbled": {},
        "diverged": {},
        "metrics": metrics,
        "ledger": ledger,
    }
    return SimpleNamespace(**common | state)


def line(
    monkeypatch: pytest.MonkeyPatch, recorded: Any, *changes: str, width: int = 80, live: bool = True, waiting: str = ""
) -> str:
    """What is shown 4 s after the first call."""
    out = io.StringIO()
    status = StatusLine(Terminal(file=out, force_terminal=live, width=width), quiet=False, first_s=0.0)
    show = ProgressLine(small("duration=180 s", *changes), recorded, status, lambda: waiting)
    monkeypatch.setattr(status, "due", lambda: False)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: 100.0))
    show()
    monkeypatch.setattr(status, "due", lambda: True)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: 104.0))
    show()
    return out.getvalue().removeprefix("\r").removesuffix("\x1b[K").removesuffix("\n")


def test_what_matters_stays_at_every_width(monkeypatch: pytest.MonkeyPatch) -> None:
    screens = []
    for name, state in STATES.items():
        values = dict(state)
        waiting = values.pop("waiting", "")
        screens.append(f"# {name}: 120, 80 and 60 columns, no terminal\n")
        for width in (120, 80, 60):
            shown = line(monkeypatch, journal(**values), width=width, waiting=waiting)
            assert len(shown) < width
            assert "60.0" in shown and "180 s" in shown and "error " in shown
            assert "fault" in shown or not values.get("active")
            assert "agent 3" in shown or not waiting
            screens.append(f"{shown}\n")
        screens.append(f"{line(monkeypatch, journal(**values), live=False, waiting=waiting)}\n\n")
    assert_screen("progress", "".join(screens))


def test_a_continuation_counts_from_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """40 s were simulated in 4 s, a third of what there is to simulate; the time shown is that of the log."""
    shown = line(monkeypatch, journal(begin=2000), width=180)
    assert shown.startswith("t = 60.0 / 180 s  ━━━━━━────────────────── ") and "  10.0 x real time  " in shown


def test_there_is_no_speed_before_any_time_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    status = StatusLine(Terminal(file=out, force_terminal=True, width=200), quiet=False)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: 100.0))
    ProgressLine(small(), journal(), status, lambda: "")()
    assert "real time" not in out.getvalue() and "formation error" in out.getvalue()


def test_moored_vehicles_have_no_formation_error(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = line(monkeypatch, journal(), "moored=true", "agent=fleet.protocols.average:NaiveAverage", width=120)
    assert "/ 180 s" in shown and "123456 delivered" in shown
    assert "error" not in shown and "median" not in shown
