"""The times of start-up. Which modules light commands may not import is in tests/fleet/cli/test_main.py."""

from __future__ import annotations

import sys

import pytest

from benchmarks import start_up
from benchmarks.start_up import COMMANDS, cpu_times
from fleet.errors import FleetError


def test_each_command_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Byte code is written to a folder of our own, whatever the environment says, and found there the next time."""
    found = "import sys; sys.exit(0 if sys.pycache_prefix and not sys.dont_write_bytecode else 'no byte code')"
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setattr(
        start_up, "COMMANDS", {"first": [sys.executable, "-c", found], "second": COMMANDS["fleet list"]}
    )
    times = cpu_times(1)
    assert list(times) == ["first", "second"]
    assert all(0 < spent < float("inf") for spent in times.values())


def test_a_command_that_fails_ends_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        start_up.COMMANDS, "fleet list", [sys.executable, "-c", "import sys; sys.exit('no such thing')"]
    )
    with pytest.raises(FleetError, match="fleet list exited with status 1: no such thing"):
        cpu_times(1)
