"""A fleet of many processes starts, gives the same log as in one process, and ends without leaving anybody."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest
from in_process_runs import recorded

from fleet.result.result import Status

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

FLEET = ["vehicles=200", "tick=100 ms", "duration=2 s", "checks={ledger: balanced, tumbled: waived}"]


def test_two_hundred_vehicles(tmp_path: Path) -> None:
    apart = recorded(tmp_path / "apart", "paper", *FLEET, in_process=False)
    assert apart.status is Status.PASS, (apart.reason, apart.lines)
    one = recorded(tmp_path / "one", "paper", *FLEET)
    assert apart.values["digest"] == one.values["digest"]
    assert [p for p in psutil.Process().children(recursive=True) if "[paper]" in " ".join(p.cmdline())] == []
