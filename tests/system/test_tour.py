"""The tour: its commands, in their order, in one empty folder."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

TOUR = (ROOT / "docs" / "guide" / "tour.md").read_text("utf-8").partition("\n\n")[2].partition("\n## ")[0]
STEPS = dict(re.findall(r"^(\d+)\. (.*?)(?=^\d+\. |^$)", TOUR, re.MULTILINE | re.DOTALL))
ALONE = range(1, 9)  # step 9 needs a second terminal, and step 10 takes minutes; both have tests of their own
LONG = ("fleet movie",)  # drawn in tests/addons/page


def commands(step: int) -> list[str]:
    """What a step says to type."""
    found = re.findall(r"`(fleet [a-z][^`]*)`", STEPS[str(step)])
    return [part for text in found for part in " ".join(text.split()).split(" && ") if part not in LONG]


def test_the_tour_has_ten_steps_with_commands() -> None:
    assert list(STEPS) == [str(n) for n in range(1, 11)]
    assert all(commands(step) for step in range(1, 11))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_tour_can_be_taken(tmp_path: Path) -> None:
    """Nothing is asked for that is not there, and what looks at a run looks at the one that the tour means."""
    fleet = str(Path(sys.executable).with_name("fleet"))
    said = {}
    for step in ALONE:
        for command in commands(step):
            done = subprocess.run(
                [fleet, *shlex.split(command)[1:]], cwd=tmp_path, capture_output=True, text=True, check=False
            )
            assert done.returncode in (0, 1) and "Traceback" not in done.stderr, f"{command}: {done.stderr}"
            said[command] = done
    first = said["fleet run rough-sea"].stdout.splitlines()[-1]
    for command in ("fleet plot", "fleet verify", "fleet whatif --agent 3 --controller boc"):
        assert said[command].returncode == 0
        assert f"the newest run: {first}" in said[command].stderr
    assert "the commands differ" in said["fleet whatif --agent 3 --controller boc"].stdout
    assert said["fleet run --from runs/latest@20s --set controller=boc"].returncode == 1  # as the step says
    assert said["fleet run gossip.yaml"].returncode == 0
    assert "the formation is not kept" in said["fleet check breakdown"].stderr
