"""Commands that need no extra, where the libraries of the extra `study` are not installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

from fleet.study.engine import NEEDED

# piqp brings scipy.
WITHOUT = f"""
import sys
sys.modules.update(dict.fromkeys({tuple(name for name in NEEDED if name != "scipy")}))
from fleet.__main__ import main
main()
"""
SHORT = ["--set", "duration=2 s", "--set", "checks={}"]
FAILS = """
title: Two vehicles, one of which dies
vehicles: 2
duration: 2 s
reference: {start: 0 0 5 m, velocity: 0.5 0 0 m/s}
formation: {shape: line, spacing: 8 m}
graph: {shape: path}
initial: {scatter: 0.5 m, around: reference}
network: {period: 100 ms, links: {'*': delay 100ms loss 20%}}
checks: {formation_error: {below: 1 mm, after: 1 s}}
faults: [{at: 500 ms, kill: 2}]
"""


def fleet(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )


@pytest.mark.timeout(300)
def test_search_regress_rare_shrink_and_why_need_no_table_of_runs(tmp_path: Path) -> None:
    (tmp_path / "fails.yaml").write_text(FAILS)
    rare = ["--check", "max_age", "--set", "duration=2 s", "--set", "checks={max_age: {below: 1 s}}"]
    for status, arguments in [
        (0, ["search", "election", "--nemesis", "--budget", "1", *SHORT]),
        (1, ["search", "fails.yaml", "--nemesis", "--budget", "1", "--keep", "kept"]),
        (0, ["regress", "kept"]),
        (0, ["rare", "lossy", "--repeats", "1", "--effort", "4", *rare]),
        (0, ["shrink", "fails.yaml", "--budget", "2"]),
        (1, ["run", "fails.yaml", "--in-process"]),
        (0, ["why", "--budget", "2"]),
    ]:
        done = fleet(tmp_path, *arguments)
        assert done.returncode == status, f"{arguments}\n{done.stdout}\n{done.stderr}"
    done = fleet(tmp_path, "sweep", "fails.yaml")
    assert done.returncode == 2
