"""What `fleet run --junit` writes: cases with the time of the run, and a command that makes the same run again."""

from __future__ import annotations

import shlex
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tool import invoke


@pytest.mark.parametrize("junit", [("--junit", "one.xml"), ("--junit=one.xml",)])
def test_the_command_of_a_case_makes_the_same_run(
    junit: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It named the scenario and the seed alone; a changed network, a fault and a file were lost."""
    monkeypatch.chdir(tmp_path)
    options = ("--duration", "12 s", "--in-process", "-q", "--net", "* loss 99%", "--set", "checks.tumbled=waived")
    first = invoke("run", "paper", *junit, *options, "--fault", "at 2s for 1s mute 2")
    root = ElementTree.parse(tmp_path / "one.xml").getroot()
    cases = [*root.iter("testcase")]
    assert cases and float(root.get("time", "0")) > 0.0
    assert all(float(case.get("time", "0")) > 0.0 for case in cases)
    said = {case.findtext("system-out") for case in cases}
    command, _, remark = said.pop().partition("  # ")  # type: ignore[union-attr]
    assert not said
    assert "--junit" not in command  # whoever pastes it would lose the file that he reads
    again = invoke(*shlex.split(command)[1:], "--junit", "two.xml")
    assert again.exit_code == first.exit_code
    assert remark in (tmp_path / "two.xml").read_text()
