"""The page "Your protocol": what it gives runs, passes where it says so, and fails where it says so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from repository import ROOT

from fleet.execution.whole_run import run

PAGE = (ROOT / "docs/guide/your-protocol.md").read_text("utf-8")


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in re.findall(r"```(?:python|yaml)\n(.*?)```", PAGE, re.S):
        (tmp_path / re.match(r"# (\w+\.\w+)\n", text)[1]).write_text(text, "utf-8")  # type: ignore[index]
    monkeypatch.chdir(tmp_path)


@pytest.mark.once
def test_it_passes() -> None:
    result = run("weakest.yaml", set={"log.every": "5 ticks"})
    assert [verdict.check for verdict in result.checks if not verdict.passed] == []
    assert {verdict.check for verdict in result.checks} >= {"one-answer", "five-is-back"}


def test_the_network_that_breaks_it() -> None:
    """Also without loss: it is the delay, as the table of the page says."""
    result = run(
        "weakest.yaml",
        set={
            "network.links": "{'*': delay 1 s}",
            "duration": "12 s",
            "faults": [],
            "checks.signal": "{name: one-answer, topic: control.weakest, agree_within: 5 s, after: 2 s}",
        },
    )
    (failed,) = (verdict for verdict in result.checks if not verdict.passed)
    assert failed.check == "one-answer"
    assert "7.01 s, for 5.01 s by then" in failed.found
