"""How runs end that do not end well: who, how, the last lines, quickly, with a readable log and nobody left behind.

Real processes, killed from outside in mid-run. The promise is an end within 2 s of a death; `LiveRun.ends` prints what
it measured and allows more, because other tests share the machine.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from ended_runs import CHECKS, LONG
from first_difference import assert_same_bytes
from hand import began
from in_process_runs import Alone, log_of, recorded
from live import FORKSERVER, LiveRun
from marks import slow
from spawned import fleet
from tool import invoke
from waiting import wait_for

from fleet.mcap.reader import LogReader
from fleet.result.result import Status


def assert_readable(run: LiveRun, least_s: float = 1.0) -> None:
    """The log reads up to the last flushed second at least, by our reader and by `fleet info`."""
    reader = LogReader(run.log)
    last = max(record.log_ns for record in reader) / 1e9
    assert last >= least_s
    info = invoke("info", run.directory, "--json")
    assert (info.exit_code, info.stderr) == (0, "")
    assert json.loads(info.stdout)["end_s"] == last
    assert json.loads(info.stdout)["run"]["scenario"] == "paper"


# --- kill -9 ---------------------------------------------------------------


@pytest.mark.parametrize("victim", ["agent 3", FORKSERVER, *slow("world", "netem")])
def test_death_of_a_process_ends_the_run_and_is_explained(victim: str, tmp_path: Path) -> None:
    """Of each kind of process: status 3, a sentence with role, pid, signal and sim time, what it printed last."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        victim_process = run.until_running().role(victim)
        victim_process.kill()
        run.ends(3)
        name = "the fork server" if victim == FORKSERVER else victim
        assert f"run broke: {name} (pid {victim_process.pid}) was killed by SIGKILL at t = " in run.said
        if victim != FORKSERVER:
            assert f"log/{victim.replace(' ', '-')}.log: (nothing printed)" in run.said
        assert_readable(run)
        result = json.loads((run.directory / "result.json").read_text())
        assert (result["exit"], result["status"]) == (3, "broken")
        assert "SIGKILL" in result["reason"]
        assert not (run.directory / "connection.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("stopped", [None, "agent 2", "world", FORKSERVER])
def test_death_of_the_console_leaves_no_orphan(stopped: str | None, tmp_path: Path) -> None:
    """The kernel's parent-death signal reaches everybody, also a process that is stopped and so cannot act itself,
    and also behind a stopped fork server: the chain is signals, not cooperation."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running()
        if stopped:
            run.role(stopped).suspend()
        run.send(signal.SIGKILL)
        run.ends(137)
        assert_readable(run)


def appeared(run: LiveRun, role: str) -> psutil.Process | None:
    """The process of a role once it is there."""
    try:
        return run.role(role)
    except AssertionError:
        return None


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["agent 4", "world", "netem", FORKSERVER])
def test_death_before_everyone_is_ready(victim: str, tmp_path: Path) -> None:
    """A process that dies while the others are still starting is explained as well, and not waited for."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        if victim == FORKSERVER:  # it starts before the scenario is read, and until it has a child nobody needs it
            wait_for(lambda: appeared(run, "world"), 60.0, "world")
        wait_for(lambda: appeared(run, victim), 60.0, victim).kill()
        run.ends(3)
        assert "run broke: " in run.said
        assert "SIGKILL" in run.said or (victim == FORKSERVER and "could not be started" in run.said)


# --- Ctrl-C, suspension ----------------------------------------------------


def test_ctrl_c(tmp_path: Path) -> None:
    """A terminal sends SIGINT to the whole group; only the console may take it as an order."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running().send(signal.SIGINT, group=True)
        run.ends(130)
        assert "stopped: interrupted" in run.said
        assert "KeyboardInterrupt" not in run.said
        assert_readable(run)
        assert LogReader(run.log).missing == ""
        result = json.loads((run.directory / "result.json").read_text())
        assert (result["exit"], result["status"]) == (130, "interrupted")


@pytest.mark.slow
@pytest.mark.parametrize("moment", [FORKSERVER, "world", "agent 4"])
def test_ctrl_c_while_starting(moment: str, tmp_path: Path) -> None:
    """As soon as a process appears, others are being started: none of them is forgotten."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        wait_for(lambda: appeared(run, moment), 60.0, moment)
        run.send(signal.SIGINT, group=True)
        run.ends(130)


@pytest.mark.slow
def test_ctrl_c_again_and_again(tmp_path: Path) -> None:
    """An impatient user: further ones while the run is being ended leave neither processes nor a traceback."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running()
        pressed = 0

        def press() -> bool:
            nonlocal pressed
            if not run.over:
                run.send(signal.SIGINT, group=True)
                pressed += 1
            return run.over

        wait_for(press, 60.0, "the end")
        assert pressed > 1
        run.ends(130)


@pytest.mark.slow
@pytest.mark.parametrize("suspended", ["agent 2", "world", "netem"])
def test_suspended_process_is_a_stall_that_names_it(suspended: str, tmp_path: Path) -> None:
    """A forgotten SIGSTOP kills nobody: after `stall_timeout` the run says for whom it waited, and why."""
    with LiveRun(tmp_path / "runs", "paper", *LONG, "--set", "stall_timeout=1 s") as run:
        process = run.until_running().role(suspended)
        process.suspend()
        run.ends(3)
        assert "nothing moved for 1 s at t = " in run.said
        assert suspended in run.said.split("nothing moved")[1].splitlines()[0]
        assert f"(pid {process.pid} is suspended)" in run.said
        assert_readable(run)


@pytest.mark.slow
def test_suspension_shorter_than_the_timeout_changes_nothing(tmp_path: Path, alone: Alone) -> None:
    """Sim time does not know of the pause: the log is that of a run without it, byte for byte."""
    arguments = ["--duration", "4 s", "--set", CHECKS]
    with LiveRun(tmp_path / "paused", "paper", *arguments, "--speed", "0.05") as run:
        hand, agent = began(run), run.role("agent 2")
        agent.suspend()
        wait_for(lambda: agent.status() == psutil.STATUS_STOPPED, 60.0, "the suspension")
        stood = hand.now()
        hand.clock("speed")  # as fast as it goes, which is not at all
        # Nothing moves any more once what was under way has arrived.
        wait_for(lambda: hand.now() == hand.now(), 60.0, "the standstill")
        assert hand.now() - stood <= 1.0
        agent.resume()
        assert run.status() == 0, run.printed
        assert_same_bytes(log_of(alone("paper", CHECKS, "duration=4 s")), run.log)


# --- places that cannot be used --------------------------------------------


def test_taken_port(tmp_path: Path) -> None:
    """The world cannot listen: a word with the port, status 3, and no wait for an answer that cannot come."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with LiveRun(tmp_path / "runs", "paper", "--port", str(port), *LONG) as run:
            run.ends(3)
            assert str(port) in run.said


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["a file as parent", "a file", "proc", "read-only"])
def test_impossible_output_directory(kind: str, tmp_path: Path, read_only: Path) -> None:
    """Status 2 before anything is started, with the place and what to do about it."""
    file = tmp_path / "file"
    file.write_text("")
    out = {"a file as parent": file / "runs", "a file": file, "proc": Path("/proc/runs"), "read-only": read_only}[kind]
    done = fleet("run", "paper", "--out", out)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"fleet: cannot make a run directory in {out}: ")
    assert done.stderr.endswith("choose another place with --out DIR\n")


def mount(folder: Path, options: str) -> Iterator[Path]:
    """A small file system in memory, where that is permitted."""
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if made.returncode:
        pytest.skip(f"mounting is not permitted here: {made.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A directory that even root cannot write to."""
    yield from mount(tmp_path / "read-only", "ro,size=64k")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    yield from mount(tmp_path / "disk", "size=400k")


@pytest.mark.slow
def test_full_disk(small_disk: Path) -> None:
    """The log stops where the disk ends: status 3, one sentence, and what was written before can be read."""
    with LiveRun(small_disk / "runs", "paper", "--duration", "60 s") as run:
        run.ends(3)
        assert f"cannot write the log {run.log}: No space left on device" in run.said
        assert_readable(run)


def test_full_disk_in_process(small_disk: Path) -> None:
    """The same from the plain loop, where no other process is there to be ended."""
    result = recorded(small_disk / "runs", "paper")
    assert result.status is Status.BROKEN
    assert "No space left on device" in result.reason
    assert max(record.log_ns for record in LogReader(result.directory / "run.mcap")) >= 1_000_000_000
