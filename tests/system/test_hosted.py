"""Agents that share a process: the same log, and each with a life of its own."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from ended_runs import CHECKS, LONG
from failing_laws import failing
from failing_laws import module as module
from first_difference import assert_same_bytes
from hand import began
from in_process_runs import Alone, log_of, recorded
from live import READY_S, LiveRun
from tool import tool
from waiting import wait_for

from fleet.errors import FleetError
from fleet.result.result import Result, Status
from netem.clock import Clock

SHARED = "agents.per_process=3"  # of four: two and two
KILLED = "faults=[{at: 1 s, kill: '2, 7'}]"


def shared_run(out: Path, *overrides: str, per_process: int = 3) -> Result:
    return recorded(out, "paper", CHECKS, *overrides, f"agents.per_process={per_process}", in_process=False)


@pytest.mark.slow  # the table of the same bytes has a hosted run
def test_the_same_bytes_as_in_one_process_and_as_with_one_each(tmp_path: Path, alone: Alone) -> None:
    """Twelve agents of which two end, while others of the same process go on. Other mechanisms: test_same_bytes.py."""
    overrides = ("duration=1.6 s", "vehicles=12", "graph.shape=ring", "network.period=10 ms", KILLED)
    together = shared_run(tmp_path / "together", *overrides)
    assert together.status is Status.PASS, (together.reason, together.lines)
    assert together.wall.per_process > 1
    assert together.directory is not None
    assert_same_bytes(log_of(alone("paper", CHECKS, *overrides, SHARED)), together.directory / "run.mcap")
    apart = shared_run(tmp_path / "apart", *overrides, per_process=1)
    assert (apart.digest, apart.wall.per_process) == (together.digest, 1)


@pytest.mark.parametrize(("policy", "next_life"), [("continue", False), ("restart", True)])
def test_a_law_that_raises_ends_its_own_agent(
    policy: str, next_life: bool, tmp_path: Path, alone: Alone, module: Callable[[str], str]
) -> None:
    law = f"controller={{law: '{module(failing(51, '1 / 0'))}:Law'}}"
    overrides = ["duration=1.5 s", law, "on_controller_error=die", f"on_death={policy}"]
    result = shared_run(tmp_path, *overrides)
    assert result.status is Status.PASS, (result.reason, result.lines)
    assert {i: len(how) for i, how in result.deaths.items()} == {"2": 1}
    died, then = [note for note in result.notes if "agent 2" in note]
    assert "ZeroDivisionError" in died
    assert "agent 2 (host-1, pid " in then
    assert ("another one takes over" in then) == next_life
    if not next_life:
        assert result.digest == alone("paper", CHECKS, *overrides, SHARED).digest


@pytest.mark.parametrize(
    ("line", "policy", "words"),
    [
        ("1 / 0", "on_controller_error=abort", r"agent 2 \(host-1, pid \d+\) exited with status 70"),
        ("import os; os._exit(3)", "on_death=abort", r"host 1 \(pid \d+\) exited with status 3 .* agent 2 computed"),
        (
            "__import__('time').sleep(3600)",
            "stall_timeout=1 s",
            r"nothing moved for 1 s .*waiting for agent 2 \(host-1, pid \d+\)$",
        ),
    ],
)
def test_a_law_that_ends_or_hangs_its_process_is_named(
    line: str, policy: str, words: str, tmp_path: Path, module: Callable[[str], str]
) -> None:
    law = f"controller={{law: '{module(failing(51, line))}:Law'}}"
    result = shared_run(tmp_path, "duration=2 s", law, policy)
    assert result.status is Status.BROKEN
    assert re.search(words, result.reason), result.reason


def test_a_host_that_is_killed_takes_its_agents_along_and_nobody_else(tmp_path: Path) -> None:
    """The others go on, until Ctrl-C, which a terminal sends to the hosts as well."""
    arguments = [*LONG, "--set", CHECKS, "--set", SHARED, "--set", "on_death=continue"]
    with LiveRun(tmp_path / "runs", "paper", *arguments) as run:
        hand = began(run)
        run.role("host 1").kill()
        without = re.compile("^[12] +no agent ", re.MULTILINE)
        wait_for(lambda: len(without.findall(tool(run.out, "status").stdout)) == 2, READY_S, "their deaths")
        hand.until(hand.now() + 1.0)
        run.send(signal.SIGINT, group=True)
        run.ends(130)
        deaths = json.loads((run.directory / "result.json").read_text())["deaths"]
        assert [(i, how[0][:21]) for i, how in deaths.items()] == [(i, "was killed by SIGKILL") for i in "12"]
        assert "agent 1 (host-1, pid " in run.said


def test_refused_on_a_wall_clock(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match=r"agents.per_process: 3: with --clock real .*agents.per_process=1"):
        recorded(tmp_path, "paper", SHARED, in_process=False, clock=Clock.REAL)
    assert list(tmp_path.iterdir()) == []
