"""The stacks of docs/examples: programs of ROS 2, MAVLink and plain sockets keep their promises."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

from fleet.result.file import read_result

TRIES = 3  # a machine that is busy with other tests is late


def verdicts(name: str, folder: Path) -> dict[str, bool | None]:
    """Run an example where it lies; returns what became of its checks."""
    stack = folder / name
    shutil.copytree(ROOT / "docs" / "examples" / name, stack)
    found: dict[str, bool | None] = {}
    for _ in range(TRIES):
        words = [sys.executable, "-m", "fleet", "netem", "stack.yaml", "--quiet"]
        done = subprocess.run(words, cwd=stack, capture_output=True, text=True, timeout=120, check=False)
        assert done.stdout, done.stderr
        found = {one.check: one.passed for one in read_result(stack / done.stdout.strip()).checks}
        if found["punctual"]:
            break
    return found


@pytest.mark.slow
def test_a_transfer_by_plain_sockets_ends_with_every_block(tmp_path: Path) -> None:
    assert verdicts("socket_stack", tmp_path) == {"arrives": True, "programs": True, "punctual": True}


@pytest.mark.slow
def test_a_ground_station_of_mavlink_reads_every_parameter(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    assert verdicts("mavlink_stack", tmp_path) == {"programs": True, "punctual": True}


@pytest.mark.slow
def test_a_node_of_ros_2_dives_to_what_another_says(tmp_path: Path) -> None:
    pytest.importorskip("zenoh_ros2_sdk")
    pytest.importorskip("rosbags")
    assert verdicts("ros2_stack", tmp_path) == {"dives": True, "programs": True, "punctual": True}
