"""`fleet status`: what fits on a screen of 80 columns, and how it is shown again and again."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from live_directory import live_directory
from rich.console import Console
from screens import assert_screen
from tool import invoke

from fleet.cli.live import screen, watch_run
from fleet.execution.answers import RunStatus
from fleet.execution.connection import RemoteError, find


def answer(vehicles: int = 4, links: int = 5, faults: int = 1, **more: Any) -> dict[str, Any]:
    """What the console of a run says; of vehicle i the formation error is i metres."""
    return {
        "scenario": "paper",
        "at_s": 12.4,
        "end_s": 60.0,
        "clock": "1 x real time",
        "waiting": "",
        "formation": {"worst_m": float(vehicles), "vehicle": vehicles, "median_m": 1.0, "vehicles": vehicles},
        "delivered": 10_000_000,
        "lost": 3_000_000,
        "faults": [
            {
                "id": f"live-{k}",
                "what": "partition 1,2,3,4,5,6,7,8,9,10 / 11,12,13,14,15,16,17,18,19,20",
                "from_s": 10.0,
                "to_s": 22.4,
                "until_healed": False,
                "state": "active",
            }
            for k in range(1, faults + 1)
        ],
        "events": [],
        "vehicles_total": vehicles,
        "vehicles": [
            {
                "vehicle": i,
                "state": "tumbled, no agent",
                "formation_m": float(i),
                "e_m": 12345.678,
                "settled": False,
                "oldest_s": 1234.5,
                "oldest_of": 20,
            }
            for i in range(1, vehicles + 1)
        ],
        "links_total": links + 1,
        "links": [
            {"src": i, "dst": i + 1, "delivered": 1_000_000, "lost": 1_000_000, "lost_share": 0.5, "age_s": 1234.5}
            for i in range(1, links + 1)
        ],
    } | more


def shown(values: dict[str, Any], height: int | None = None, *, every: bool = False) -> list[str]:
    """The lines on a terminal of 80 columns."""
    status = msgspec.convert({"run": "paper-disturbed-1-20261122-120000", "directory": "/x", **values}, RunStatus)
    terminal = Console(width=80, record=True, highlight=False, file=io.StringIO())
    terminal.print(screen(status, every, height))
    return terminal.export_text().splitlines()


def test_a_status_in_80_columns() -> None:
    assert_screen("status", "".join(f"{line.rstrip()}\n" for line in shown(answer())))


@settings(max_examples=25)
@given(height=st.integers(10, 100), vehicles=st.integers(1, 500), links=st.integers(1, 500))
@example(height=10, vehicles=1, links=1)
@example(height=10, vehicles=500, links=500)
@example(height=16, vehicles=4, links=5)
@example(height=100, vehicles=500, links=1)
def test_it_fits_any_screen(height: int, vehicles: int, links: int) -> None:
    """The time, who is waited for and at least the worst vehicle and the worst link stay."""
    lines = shown(answer(vehicles, links, waiting="waiting for agent 3, 4 s"), height)
    assert len(lines) <= height
    assert max(len(line) for line in lines) <= 80
    text = "\n".join(lines)
    assert "t = 12.40 of 60 s" in lines[0] and "waiting for agent 3, 4 s" in text
    assert re.search(rf"^{vehicles} +tumbled", text, re.MULTILINE) and re.search(r"^1->2 ", text, re.MULTILINE)
    rows = len(re.findall(r"tumbled", text)), len(re.findall(r"->", text))
    assert (f"{vehicles - rows[0]} more vehicle" in text) == (rows[0] < vehicles)
    assert f"{links + 1 - rows[1]} more link" in text


def event(i: int, *, lasts: bool = False) -> dict[str, Any]:
    return {"what": f"tumbled {i}", "times": i, "first_s": 12.45, "last_s": 30.0, "lasts": lasts, "id": f"tumbled-{i}"}


def test_moored_vehicles_have_no_errors_to_tell() -> None:
    """They are where they began: errors of 0.000 m that nobody asked for stood in each row."""
    values = answer()
    still = [row | {"formation_m": 0.0, "e_m": 0.0} for row in values["vehicles"]]
    text = "\n".join(shown(values | {"vehicles": still}))
    assert not any(word in text for word in ("formation", "settled", " e ", "0.000 m"))
    assert "1234.50 s, of 20" in text and "tumbled, no agent" in text


def test_events_of_vehicles_are_no_faults() -> None:
    lines = [line.rstrip() for line in shown(answer(events=[event(1), event(3, lasts=True)]))]
    assert [line for line in lines if line.startswith("event")] == [
        "event tumbled 1: at 12.45 s",
        "event tumbled 3: 3 times, first at 12.45 s, and still is",
    ]
    many = shown(answer(500, events=[event(i) for i in range(1, 100)]), 24)
    assert "and events of 96 more vehicles: fleet status --all" in [line.rstrip() for line in many]
    assert len(shown(answer(500, faults=40, events=[event(i) for i in range(1, 100)]), 24)) <= 24


def test_many_faults_are_counted() -> None:
    assert "and 35 more faults: fleet status --all" in shown(answer(faults=40), 24)


@pytest.mark.parametrize(
    ("until_healed", "to_s", "words"),
    [
        (True, 60.0, "until healed"),
        (False, 60.0, "to the end"),
        (False, 20.0, "7.6 s left"),
        (False, 1.0, "0.0 s left"),
    ],
)
def test_how_long_a_fault_lasts(until_healed: bool, to_s: float, words: str) -> None:
    fault = {"id": "f", "what": "mute 3", "from_s": 1.0, "to_s": to_s, "until_healed": until_healed, "state": "active"}
    assert f"fault f: {words}: mute 3" in [line.rstrip() for line in shown(answer(faults=0) | {"faults": [fault]})]


def test_all_faults_are_told_with_their_state() -> None:
    fault = {"id": "f", "what": "mute 3", "from_s": 20.0, "to_s": 22.0, "until_healed": False, "state": "to come"}
    lines = shown(answer(faults=40, events=[event(i) for i in range(1, 9)]) | {"faults": [fault] * 40}, every=True)
    lines = [line.rstrip() for line in lines]
    assert lines.count("fault f: to come, 20.00 s to 22.00 s: mute 3") == 40
    assert sum(line.startswith("event") for line in lines) == 8


def test_numbers_that_are_not_finite() -> None:
    """What diverged has no size."""
    values = answer(1)
    values["vehicles"][0] |= {"formation_m": float("nan"), "e_m": float("inf"), "oldest_s": None, "oldest_of": None}
    values["formation"] |= {"worst_m": float("inf")}
    assert any(re.match(r"1 .* nan m +inf m +no +-$", line.rstrip()) for line in shown(values, 24))
    document = msgspec.convert({"run": "a", "directory": "/x", **values}, RunStatus)
    assert json.loads(msgspec.json.encode(document))["formation"]["worst_m"] is None


class Ends:
    """A console that answers some times, and is gone then."""

    def __init__(self, times: int) -> None:
        self.times = times
        self.asked: list[dict[str, Any]] = []

    def __call__(self, run: Any, op: str, **fields: Any) -> dict[str, Any]:
        self.asked.append(fields)
        if len(self.asked) > self.times:
            raise RemoteError("gone")
        return answer()


def test_watching_ends_with_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a terminal: one block after the other, and no control character."""
    monkeypatch.setattr("fleet.execution.connection.ask", ask := Ends(3))
    monkeypatch.setattr("fleet.execution.connection.is_live", lambda run: False)
    monkeypatch.setattr("fleet.cli.live.EVERY_S", 0.0)
    with live_directory(tmp_path) as run:
        result = invoke("status", "-w", "--all")
    assert result.exit_code == 0
    assert ask.asked == [{"all": True}] * 4
    assert result.stdout.count(f"{run.name}: t = 12.40 of 60 s") == 3
    assert result.stdout.splitlines()[-1] == f"{run.name}: the run is over; its results are in {run}"
    assert "\x1b" not in result.stdout


def test_a_terminal_is_left_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends a screen of its own; the cursor is there again, and what was shown last stays."""

    def ask(run: Any, op: str, **fields: Any) -> dict[str, Any]:
        if asked:
            raise KeyboardInterrupt
        asked.append(op)
        return answer(100, 9)

    asked: list[str] = []
    monkeypatch.setattr("fleet.execution.connection.ask", ask)
    monkeypatch.setattr("fleet.cli.live.EVERY_S", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    terminal = Console(file=io.StringIO(), force_terminal=True, width=80, height=24, highlight=False)
    with live_directory(tmp_path), pytest.raises(KeyboardInterrupt):
        watch_run(find(), False, terminal)
    assert isinstance(terminal.file, io.StringIO)
    before, begun, after = terminal.file.getvalue().partition("\x1b[?1049h")
    within, ended, left = after.partition("\x1b[?1049l")
    assert begun and ended and not before
    assert within.count("\x1b[?25l") == 1 and after.count("\x1b[?25h") == 1
    assert within.count("t = 12.40 of 60 s") == 1 and left.count("t = 12.40 of 60 s") == 1


def test_watching_a_run_that_only_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.execution.connection.ask", Ends(1))
    monkeypatch.setattr("fleet.cli.live.EVERY_S", 0.0)
    with live_directory(tmp_path):
        result = invoke("status", "-w")
    assert (result.exit_code, result.stderr) == (3, "fleet: gone\n")


def test_a_status_as_a_document(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.execution.connection.ask", Ends(9))
    with live_directory(tmp_path) as run:
        found = msgspec.json.decode(invoke("status", "--json").stdout, type=RunStatus)
        assert (found.run, found.directory, len(found.vehicles)) == (run.name, str(run), 4)
        both = invoke("status", "--json", "--watch")
        assert both.exit_code == 2 and "one document" in both.stderr
