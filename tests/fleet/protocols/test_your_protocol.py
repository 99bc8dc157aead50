"""The page "Your protocol": what it gives runs, passes where it says so, and fails where it says so."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_type_hints

import pytest
from repository import ROOT

from agents.config import AgentConfig, Neighbour
from fleet.execution.whole_run import run
from netem.wire.messages import Delivery, Nav

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


@pytest.mark.parametrize("kind", [AgentConfig, Neighbour, Nav, Delivery])
def test_the_tables_have_every_field_of_what_an_agent_is_given(kind: type) -> None:
    heading = {"Nav": "`nav` (`Nav`)", "Delivery": "a delivery (`Delivery`)", "Neighbour": "a `Neighbour`"}
    table = PAGE.partition(f"| field of {heading.get(kind.__name__, f'`{kind.__name__}`')} |")[2].partition("\n\n")[0]
    first_cells = " ".join(line.split("|")[1] for line in table.splitlines() if line.startswith("| "))
    named = {re.sub(r"\W.*", "", name) for name in re.findall(r"`([^`]+)`", first_cells)}
    assert named - {"desired"} == set(get_type_hints(kind)) - {"route"}
