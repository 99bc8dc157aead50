"""What the fork server imports is not imported again by every child."""

from __future__ import annotations

import os
import subprocess
import sys

from fleet.processes.child_start import PRELOAD_VARIABLE

RUN_BY_CHILDREN = ("agents.main", "netem.main", "world.main", "fleet.processes.children")


def test_a_child_finds_everything_imported() -> None:
    """Modules of the functions that a child runs; one that is missing costs each child 1.7 MB and milliseconds."""
    code = "import sys, fleet.processes.preload; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert set(RUN_BY_CHILDREN) <= set(loaded)


def test_the_relay_of_a_stack_loads_no_laws() -> None:
    """Nor numpy: half of what a study of stacks computes was the start of processes."""
    code = "import sys, fleet.processes.preload, netem.relay_process; print(*sys.modules)"
    environment = os.environ | {PRELOAD_VARIABLE: "netem.relay_process"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert not {"agents.main", "world.main", "numpy"} & set(done.stdout.split())
