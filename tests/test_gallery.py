"""The shipped scenarios that stress the network keep their promises, and distributed gives the bytes of in-process."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.run import Options, Status, execute
from fleet.scenario import list_scenarios, load_scenario

GALLERY = [
    "lossy", "burst", "partition-heal", "kill", "kill-restart", "gauss-markov-current", "nemesis", "acoustic-80bps",
    "acoustic-s2c",
]  # fmt: skip
README = Path(__file__).parents[1] / "README.md"


@pytest.mark.parametrize("name", GALLERY)
def test_distributed_is_in_process(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name)
    alone, fleet = (execute(scenario, Options(tmp_path, in_process=flag, quiet=True)) for flag in (True, False))
    for result in (alone, fleet):
        assert result.status is Status.PASS, (result.reason, result.lines, result.verdicts)
    assert (alone.directory / "run.mcap").read_bytes() == (fleet.directory / "run.mcap").read_bytes()
    assert fleet.values["deaths"] == {}


def test_the_readme_says_what_each_teaches() -> None:
    text = README.read_text("utf-8")
    assert [name for name, *_ in list_scenarios() if f"| `{name}` |" not in text] == []
