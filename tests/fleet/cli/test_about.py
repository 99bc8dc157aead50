"""`fleet about`: the report has what one needs to repeat a run, and nothing private."""

from __future__ import annotations

from pathlib import Path

import pytest
from tool import invoke

QUICK = ["run", "paper", "--in-process", "-q", "--duration", "500 ms", "--seed", "7", "--set"]


@pytest.mark.parametrize("checks", ["{}", "{formation_error: {below: 1 mm}}"], ids=["pass", "fail"])
def test_the_report(checks: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ZENOH_SECRET", "hush")
    monkeypatch.setenv("HOME", str(tmp_path))
    without = invoke("about").output
    assert "uuv-fleet" in without and "numpy" in without and "\nrun " not in without
    directory = invoke(*QUICK, f"checks={checks}").stdout.strip()
    text = invoke("about", str(tmp_path / directory)).output
    assert "scenario       paper, seed 7, 0.5 s, digest " in text
    assert f"run            ~/{directory}\n" in text and f"fleet run ~/{directory}/scenario.yaml" in text
    assert ("\nfailed         formation_error: " in text) == ("below" in checks)
    assert "ZENOH_SECRET" in text and "hush" not in text
    (tmp_path / directory / "result.json").unlink()
    broken = invoke("about")  # the newest run, which broke before it had a result
    assert broken.exit_code == 0 and "\nresult " in broken.output
