"""The table of start-up costs. Which modules light commands may not import is in tests/fleet/cli/test_main.py."""

from __future__ import annotations

import sys
from io import StringIO

import pytest
from rich.console import Console as Terminal

from fleet.bench import start_up
from fleet.bench.errors import BenchError
from fleet.bench.start_up import COMMANDS, PYTHON, measure_start_up, start_up_table


def test_each_command_is_measured_and_compared_with_python() -> None:
    rows = measure_start_up(1)
    assert [row["command"] for row in rows] == list(COMMANDS)
    assert rows[0]["ratio"] == 1.0
    assert all(row["cpu_s"] > 0 and row["ratio"] > 0 for row in rows)
    rendered = Terminal(width=80, record=True, file=StringIO())
    rendered.print(start_up_table(rows))
    lines = rendered.export_text().splitlines()
    assert [line.rstrip() for line in lines][1].split("  ")[0] == "command"
    assert lines[2].split() == [*PYTHON.split(), f"{rows[0]['cpu_s']:.3f}", "1.0"]


def test_a_command_that_fails_ends_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        start_up.COMMANDS, "fleet list", [sys.executable, "-c", "import sys; sys.exit('no such thing')"]
    )
    with pytest.raises(BenchError, match="fleet list exited with status 1: no such thing"):
        measure_start_up(1)
