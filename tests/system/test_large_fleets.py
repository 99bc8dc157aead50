"""A fleet of many processes starts, gives the same log as in one process, and ends without leaving anybody."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest

from fleet.execution.execute import Status, execute
from fleet.execution.options import Options
from fleet.scenario.loading import load_scenario

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

FLEET = ["vehicles=200", "tick=100 ms", "duration=2 s", "checks={ledger: balanced, tumbled: waived}"]


def test_two_hundred_vehicles(tmp_path: Path) -> None:
    scenario = load_scenario("paper", FLEET)
    apart = execute(scenario, Options(tmp_path / "apart", quiet=True))
    assert apart.status is Status.PASS, (apart.reason, apart.lines)
    one = execute(scenario, Options(tmp_path / "one", quiet=True, in_process=True))
    assert apart.values["digest"] == one.values["digest"]
    assert [p for p in psutil.Process().children(recursive=True) if "[paper]" in " ".join(p.cmdline())] == []
