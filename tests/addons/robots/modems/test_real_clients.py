"""Clients of others, unchanged, on modems of a run."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_port
from stacks import Stack

PROGRAMS = Path(__file__).parent / "programs"
LIMIT_S = 200.0
WATER = {"acoustic": {"modem": "s2c", "backoff": "300 ms", "queue": 10}}


def says(program: str, *arguments: object) -> dict[str, Any]:
    """What a program prints, as JSON."""
    done = subprocess.run(
        [sys.executable, PROGRAMS / program, *map(str, arguments)],
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


@pytest.mark.slow
def test_a_program_for_unetstack_runs_as_it_is(tmp_path: Path) -> None:
    pytest.importorskip("unetpy")
    ports = [free_port(), free_port()]
    nodes = {f"auv{n}": {"modem": {"unet": port}, "place": f"{500 * n} 0 10 m"} for n, port in enumerate(ports, 1)}
    with Stack(tmp_path, nodes=nodes, network=WATER).begun() as stack:
        found = says("unet_program.py", *ports)
        result = stack.end()
    assert (found["addresses"], found["host"], found["mtu"]) == ([1, 2], 2, 64)
    assert found["heard"] == [[number, 2, 3] for number in range(5)] and all(found["sent"])
    assert all(abs(us - 333_333) <= 1 for us in found["travel_us"])  # 500 m at 1500 m/s
    assert found["too_long"] is False and found["range_m"] == pytest.approx(500.0, abs=0.01)
    assert (found["delivered"], found["by_link"]) == (2, [9, 9])
    assert result.ledger["auv1->auv2"].delivered >= 7


@pytest.mark.slow
def test_a_script_of_acomms_runs_as_it_is(tmp_path: Path) -> None:
    pytest.importorskip("acomms")
    terminals = [tmp_path / "tty1", tmp_path / "tty2"]
    places = zip(terminals, (0, 1500), strict=True)
    nodes = {
        f"n{n}": {"modem": {"micromodem": str(path)}, "place": f"{x} 0 10 m"} for n, (path, x) in enumerate(places)
    }
    with Stack(tmp_path, nodes=nodes, network=WATER).begun() as stack:
        found = says("acomms_program.py", *terminals, tmp_path)
        stack.end()
    assert found["ids"] == [1, 2] and found["travel_s"] == 1.0
    assert found["acknowledged"] == ["2", "1", "1", "1"] and found["mini"] == ["1", "2", "1ABC"]
    assert not any(path.is_symlink() for path in terminals)
