"""How a command ends when what it talks to goes away: its terminal, its standard output, a suspended fork server."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from ended_runs import LONG
from hand import began
from in_process_runs import recorded
from live import FORKSERVER, LiveRun, gone
from marks import slow
from spawned import python
from waiting import wait_for

from fleet.mcap.reader import LogReader
from fleet.processes import children
from fleet.processes.children import Children
from fleet.processes.interrupts import DeferInterrupts, HungUp, holding_interrupts
from fleet.result.result import Status

FLEET = [sys.executable, "-m", "fleet"]
SHORT = ["run", "paper", "--in-process", "--duration", "500 ms", "--set", "checks={}"]


# --- a suspended fork server --------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_suspended_fork_server_does_not_keep_a_run_from_ending(number: signal.Signals, tmp_path: Path) -> None:
    """It reaps nobody and tells of nobody: the children are ended by number, and so is it."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running().role(FORKSERVER).suspend()
        run.send(number)
        run.ends(130)
        assert LogReader(run.log).missing == ""


@pytest.mark.slow
def test_a_suspended_fork_server_at_the_end(tmp_path: Path) -> None:
    arguments = ["--duration", "4 s", "--speed", "0.05", "--set", "checks={ledger: balanced}"]
    with LiveRun(tmp_path / "runs", "paper", *arguments) as run:
        hand = began(run)
        run.role(FORKSERVER).suspend()
        hand.clock("speed")  # as fast as it goes
        run.ends(0)
        assert LogReader(run.log).missing == ""


@pytest.mark.slow
def test_a_death_that_a_suspended_fork_server_does_not_tell(tmp_path: Path) -> None:
    """The stall names both."""
    with LiveRun(tmp_path / "runs", "paper", *LONG, "--set", "stall_timeout=1 s") as run:
        server = run.until_running().role(FORKSERVER)
        server.suspend()
        agent = run.role("agent 3")
        agent.kill()
        run.ends(3)
        why = f"agent 3 (pid {agent.pid} has ended; the fork server (pid {server.pid}) is suspended)"
        assert why in run.said


@pytest.mark.slow
def test_nothing_starts_behind_a_suspended_fork_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wait is bounded, and the next run of this process gets a fork server that works."""
    ours, theirs = Children(lambda _: None), Children(lambda _: None)
    try:
        ours.start("one", "fleet one [test]", tmp_path / "one.log", time.sleep, 3600)
        server = psutil.Process(children._forkserver_pid() or 0)
        server.suspend()
        monkeypatch.setattr(children, "START_S", 0.3)
        with pytest.raises(TimeoutError, match=rf"the fork server \(pid {server.pid}\) is suspended, for 0.3 s now"):
            ours.start("two", "fleet two [test]", tmp_path / "two.log", time.sleep, 3600)
        monkeypatch.setattr(children, "START_S", 20.0)
        wait_for(lambda: gone(server), 60.0, "the end of the fork server")
        theirs.start("three", "fleet three [test]", tmp_path / "three.log", time.sleep, 3600)
        assert psutil.pid_exists(theirs.by_role["three"].pid)
        # What is started beside it knows nothing of that: it would take us for its parent, and end at once.
        assert _shell(["list"], ">/dev/null").returncode == 0
    finally:
        ours.stop()
        theirs.stop()


def test_a_run_does_not_go_on_with_another_fork_server(tmp_path: Path) -> None:
    """The processes that the first one started have ended with it, and it is told how it ended."""
    ours = Children(lambda _: None)
    try:
        ours.start("one", "fleet one [test]", tmp_path / "one.log", time.sleep, 3600)
        server = psutil.Process(children._forkserver_pid() or 0)
        server.kill()
        wait_for(lambda: gone(server), 60.0, "the end of the fork server")
        with pytest.raises(ChildProcessError, match=rf"the fork server \(pid {server.pid}\) was killed by SIGKILL"):
            ours.start("two", "fleet two [test]", tmp_path / "two.log", time.sleep, 3600)
    finally:
        ours.stop()


# --- Ctrl-C while processes are started and ended -------------------------------


def test_a_process_that_is_started_when_ctrl_c_comes_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who is to end the processes knows it by then."""
    telling = children._telling

    @contextlib.contextmanager
    def telling_and_interrupted(variables: dict[str, str]) -> Iterator[None]:
        with telling(variables):
            yield
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(children, "_telling", telling_and_interrupted)
    ours = Children(lambda _: None)
    try:
        with pytest.raises(KeyboardInterrupt):
            ours.start("one", "fleet one [test]", tmp_path / "one.log", time.sleep, 3600)
        process = psutil.Process(ours.by_role["one"].pid)
    finally:
        ours.stop()
    assert gone(process)


def test_ctrl_c_while_a_run_ends_its_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are ended all the same, and the command ends: an open session would keep it for ever."""
    started: list[psutil.Process] = []
    stop = Children.stop

    def interrupted(self: Children) -> None:
        started.extend(psutil.Process(child.pid) for child in self.by_role.values())
        signal.raise_signal(signal.SIGINT)
        stop(self)

    monkeypatch.setattr(Children, "stop", interrupted)
    result = recorded(tmp_path, "paper", "duration=100 ms", "checks={}", in_process=False)
    assert (result.status, result.reason) == (Status.INTERRUPTED, "interrupted")
    assert len(started) == 6
    assert all(gone(process) for process in started)
    assert not (result.directory / "connection.json").exists()


# --- a terminal that closes ---------------------------------------------------


@pytest.mark.parametrize("group", [True, *slow(False)])
def test_a_hang_up_ends_a_run_as_ctrl_c_does(group: bool, tmp_path: Path) -> None:
    """A shell sends it to the whole group, agents and all; the console alone decides what it means."""
    with LiveRun(tmp_path / "runs", "paper", *LONG) as run:
        run.until_running().send(signal.SIGHUP, group=group)
        run.ends(129)
        assert "stopped: the terminal was closed" in run.said
        assert LogReader(run.log).missing == ""
        result = json.loads((run.directory / "result.json").read_text())
        assert (result["exit"], result["status"]) == (129, "hung_up")


@pytest.mark.slow
def test_a_terminal_that_is_gone(tmp_path: Path) -> None:
    """The kernel sends SIGHUP to the foreground, and every write fails from then on."""
    runs = tmp_path / "runs"
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [*FLEET, "run", "paper", *LONG, "--out", str(runs)])
    log = runs / "latest" / "run.mcap"
    seen = bytearray()
    reader = threading.Thread(target=_drain, args=(terminal, seen), daemon=True)
    reader.start()
    wait_for(lambda: log.exists() and log.stat().st_size > 200_000, 60.0, "some of the log")
    family = psutil.Process(pid).children(recursive=True)
    os.close(terminal)
    status = _status(pid)
    assert status == 129, seen[-2000:]
    wait_for(lambda: all(gone(process) for process in family), 60.0, "the end of the others")
    assert LogReader(log).missing == ""
    assert json.loads((log.parent / "result.json").read_text())["status"] == "hung_up"


@pytest.mark.slow
def test_a_run_without_a_hang_up_outlives_its_terminal(tmp_path: Path) -> None:
    """`nohup` has it ignored: what can be told to nobody is not told, and the run goes on to its end."""
    command = ["nohup", *FLEET, *SHORT, "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        wait_for(lambda: (tmp_path / "latest").exists(), 60.0, "the run")
        process.send_signal(signal.SIGHUP)
        assert process.wait(60) == 0


def test_a_hang_up_waits_for_the_end_of_a_write() -> None:
    before = signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        whole, written = DeferInterrupts(), []

        def write() -> None:
            with whole:
                signal.raise_signal(signal.SIGHUP)
                written.append("all of it")

        with whole.handling(), pytest.raises(KeyboardInterrupt):
            write()
        assert written
        with holding_interrupts() as interrupted:
            assert interrupted() is None
            signal.raise_signal(signal.SIGHUP)
            assert isinstance(interrupted(), HungUp)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with holding_interrupts() as interrupted:
            signal.raise_signal(signal.SIGHUP)
            assert interrupted() is None
    finally:
        signal.signal(signal.SIGHUP, before)


# --- output that goes nowhere -------------------------------------------------


def _shell(arguments: list[str], redirection: str) -> subprocess.CompletedProcess[str]:
    """The command with its output as a shell redirects it."""
    script = f'set -o pipefail; "$@" {redirection}'
    return subprocess.run(
        ["bash", "-c", script, "bash", *FLEET, *arguments], capture_output=True, text=True, check=False, timeout=100
    )


FULL = "No space left on device"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirection", "why"),
    [(">&-", "it is closed"), (">/dev/full", FULL), ("<&- >&-", "it is closed")],
)
def test_a_run_that_cannot_show_its_result(redirection: str, why: str, tmp_path: Path) -> None:
    """The log is whole and judged; that the table was not seen is said, and is status 3."""
    done = _shell([*SHORT, "--out", str(tmp_path)], redirection)
    directory = tmp_path / (tmp_path / "latest").readlink().name
    said = f"fleet: cannot write to standard output: {why}; the results are in {directory}\n"
    assert (done.returncode, done.stderr[-len(said) :]) == (3, said)
    assert "Traceback" not in done.stderr
    assert LogReader(directory / "run.mcap").missing == ""
    assert json.loads((directory / "result.json").read_text())["status"] == "pass"


@pytest.mark.slow
@pytest.mark.parametrize(("check", "status"), [("ledger: balanced", 0), ("formation_error: {below: 1 mm}", 1)])
@pytest.mark.parametrize("reader", ["| true", "| head -1"])
def test_a_reader_that_has_seen_enough_changes_no_status(check: str, status: int, reader: str, tmp_path: Path) -> None:
    """`fleet run | head -1` was status 3, as of a broken run."""
    report = tmp_path / "junit.xml"
    words = ["--set", f"checks={{tumbled: waived, {check}}}", "--junit", str(report), "--out", str(tmp_path)]
    done = _shell([*SHORT, *words], reader)
    assert done.returncode == status, done.stderr
    assert "cannot write" not in done.stderr
    assert report.exists()


@pytest.mark.slow
@pytest.mark.parametrize("redirection", ["2>&-", "2>/dev/full", "2>&- <&-"])
def test_talk_that_nobody_hears_changes_nothing(redirection: str, tmp_path: Path) -> None:
    """Nor does the log get what a library would print: nothing of it has the number of stderr."""
    done = _shell([*SHORT, "--out", str(tmp_path)], redirection)
    assert (done.returncode, done.stderr) == (0, "")
    assert "digest" in done.stdout
    assert LogReader(tmp_path / "latest" / "run.mcap").missing == ""


@pytest.mark.slow
def test_processes_of_a_run_without_any_stream(tmp_path: Path) -> None:
    """Pipes and sockets do not take the numbers of the streams that are closed."""
    arguments = [word for word in SHORT if word != "--in-process"]
    done = _shell([*arguments, "--out", str(tmp_path)], "<&- >&- 2>&-")
    assert (done.returncode, done.stdout, done.stderr) == (3, "", "")
    result = json.loads((tmp_path / "latest" / "result.json").read_text())
    assert (result["status"], result["notes"]) == ("pass", [])


@pytest.mark.slow
@pytest.mark.parametrize("command", ["list", "run paper --show-config", "--help"])
def test_output_of_other_commands(command: str) -> None:
    """A reader that has seen enough needs no word; a full disk does."""
    seen_enough = _shell(command.split(), "| true")
    assert (seen_enough.returncode, seen_enough.stderr) == (141, "")
    full = _shell(command.split(), ">/dev/full")
    assert (full.returncode, full.stderr) == (3, f"fleet: cannot write to standard output: {FULL}\n")
    closed = _shell(command.split(), ">&-")
    assert (closed.returncode, closed.stderr) == (3, "fleet: cannot write to standard output: it is closed\n")


def _drain(descriptor: int, seen: bytearray) -> None:
    try:
        while data := os.read(descriptor, 65536):
            seen += data
    except OSError:
        return


def _status(pid: int) -> int:
    with ExitStack() as stack:
        killer = threading.Timer(60.0, os.kill, (pid, signal.SIGKILL))
        killer.start()
        stack.callback(killer.cancel)
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


# --- a run that ends while its processes begin --------------------------------

EARLY = """\
from multiprocessing import forkserver
from pathlib import Path
from fleet.processes.children import Children, start_forkserver
from sys import argv

start_forkserver()
early = forkserver._forkserver._forkserver_pid
children = Children(lambda _: None)
children.start("role", "title", Path(argv[1]) / "role.log", print, "begun")
children.by_role["role"].process.join(60)
children.stop()
print(early == forkserver._forkserver._forkserver_pid)
"""


def test_a_fork_server_that_was_started_before_is_the_one_that_starts_processes(tmp_path: Path) -> None:
    done = python("-c", EARLY, tmp_path)
    assert (done.stdout, done.stderr) == ("True\n", "")
    assert (tmp_path / "role.log").read_text() == "begun\n"


BEGUN_TOO_LATE = """\
import sys
from pathlib import Path
from fleet.processes.children import Children

children = Children(lambda _: None)
children.start("late", "late", Path(sys.argv[1]) / "late.log", print, "begun")
process = children.by_role["late"].process
process.join(60)
children.stop()
print(process.exitcode)
"""


def test_a_process_whose_run_is_over_before_it_begins_says_nothing(tmp_path: Path) -> None:
    """A signal in the first moments of a run: its directory is gone when the process opens its log."""
    done = python("-c", BEGUN_TOO_LATE, tmp_path / "gone")
    assert (done.stdout, done.stderr) == ("1\n", "")
