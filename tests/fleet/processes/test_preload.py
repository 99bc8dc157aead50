"""What the fork server imports is not imported again by every child."""

from __future__ import annotations

import subprocess
import sys

RUN_BY_CHILDREN = ("agents.main", "netem.main", "world.main", "fleet.processes.children")


def test_a_child_finds_everything_imported() -> None:
    """Modules of the functions that a child runs; one that is missing costs each child 1.7 MB and milliseconds."""
    code = "import sys, fleet.processes.preload; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert set(RUN_BY_CHILDREN) <= set(loaded)
