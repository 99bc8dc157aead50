"""docs/guide/your-checks.md: its scenario and its class are run as a reader would, and it has every key."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from repository import ROOT

from fleet.checks.python_check import BUDGET_S
from fleet.execution.whole_run import run_loaded
from fleet.scenario.loading import load_scenario
from fleet.scenario.schema.checks import CONDITIONS, SignalCheck

PAGE = (ROOT / "docs" / "guide" / "your-checks.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"```(yaml|python)\n(.*?)```", PAGE, re.DOTALL)[::-1])  # the first of each language


@pytest.mark.once
def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "one_leader", raising=False)
    own = re.search(r'  "one_leader:AtMostOneLeader": .*\n', PAGE)
    assert own is not None
    (tmp_path / "mine.yaml").write_text(BLOCKS["yaml"] + own[0])
    (tmp_path / "one_leader.py").write_text(BLOCKS["python"])
    result = run_loaded(load_scenario("mine.yaml"))
    found = {verdict.check: verdict for verdict in result.checks}
    assert {name for name, verdict in found.items() if not verdict.passed} == {"AtMostOneLeader", "settled"}
    settled = found["settled"]
    assert f"FAIL settled: {settled.asked}; found {settled.found} " in " ".join(PAGE.split())
    assert {"depth", "settled", "level", "recovers", "together", "heard"} <= found.keys()
    leader = found["AtMostOneLeader"]
    assert leader.moment is not None and leader.moment.vehicles == [1, 2, 3]
    assert leader.asked == "At most one vehicle leads, grace 2 s"


def test_every_key_is_on_the_page() -> None:
    assert [key for key in SignalCheck.model_fields if f"`{key}" not in PAGE and f"{key}:" not in PAGE] == []
    assert all(f"`{key}: " in PAGE for key in CONDITIONS)
    assert f"longer than {BUDGET_S:g} s for a tick" in PAGE
