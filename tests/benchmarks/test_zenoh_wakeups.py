"""The program that shows what a round trip over zenoh costs."""

import subprocess
import sys

from repository import ROOT


def test_it_measures_both_ways() -> None:
    script = str(ROOT / "benchmarks" / "zenoh_wakeups.py")
    done = subprocess.run([sys.executable, script, "--rounds", "20"], capture_output=True, text=True, check=True)
    rows = {line.split()[0]: [float(cell) for cell in line.split()[1:]] for line in done.stdout.splitlines()[1:]}
    assert list(rows) == ["pipe", "zenoh"]
    assert all(len(row) == 5 and min(row[:2]) > 0.0 for row in rows.values())
