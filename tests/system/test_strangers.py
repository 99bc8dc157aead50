"""What those who are let in, and those who are not, can take of a run: memory, time and places."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import psutil
import pytest
import zenoh
from attack import SCENARIO, Attack
from free_ports import free_port
from in_process_runs import recorded
from live import LiveRun
from spawned import fleet as fleet_process
from waiting import wait_for

import fleet.execution.launch
from fleet.execution.directory import RunDirectory
from fleet.processes.children import Children, Exit
from fleet.processes.run_folder import RunFolder
from fleet.result.result import Result, Status
from netem.wire.bus import Bus
from netem.wire.credentials import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus
from netem.wire.session import PIECE_BYTES

HUGE = 150_000_000


def attacked(attack: Callable[[Attack, Keys, str], None], patch: pytest.MonkeyPatch, out: Path) -> Result:
    """A run that is attacked while its processes get ready, by somebody who has agent 3's login."""
    thief = Attack()
    write = RunDirectory.write_connection

    def write_and_attack(directory: RunDirectory, values: dict[str, Any]) -> None:
        write(directory, values)
        keys = Keys(values["run"])
        thief.wait_until_up(keys, values["endpoint"])
        attack(thief, keys, values["endpoint"])

    patch.setattr(fleet.execution.launch, "generate", thief.generate)
    patch.setattr(RunDirectory, "write_connection", write_and_attack)
    try:
        return recorded(out, "paper", *SCENARIO, in_process=False)
    finally:
        thief.close()


def assert_unharmed(result: Result, tmp_path: Path) -> None:
    """It has passed, with the log of a run in one process."""
    assert (result.status, result.reason, result.lines) == (Status.PASS, "", [])
    assert result.digest == recorded(tmp_path / "alone", "paper", *SCENARIO).digest


@pytest.mark.slow
@pytest.mark.parametrize("session", [Bus, OpenBus], ids=["in one piece", "in pieces"])
def test_a_huge_message(session: type[Bus | OpenBus], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """On the keys that its login lets it use: the world grows by nothing, and the others go on."""
    peak: list[int] = []

    def huge(thief: Attack, keys: Keys, endpoint: str) -> None:
        with closing(session.connect(endpoint, thief.credentials["agent-3"])) as bus:
            for key in (keys.tx(3), keys.cmd(3)):
                for size in (50_000, PIECE_BYTES - 100, HUGE):
                    with suppress(zenoh.ZError):  # it was cut off; its session makes another link
                        bus._session.put(key, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
        world = next(p for p in psutil.Process().children(recursive=True) if "fleet world" in " ".join(p.cmdline()))
        peak.append(high_water(world.pid))

    result = attacked(huge, monkeypatch, tmp_path / "runs")
    assert_unharmed(result, tmp_path)
    assert peak[0] < 100e6


def high_water(pid: int) -> int:
    """The most memory that a process has had [bytes]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:")) * 1024


# --- who has no login ------------------------------------------------------


def test_nobody_else_gets_at_the_socket() -> None:
    """Another user cannot even connect, so there is nothing to hold, to guess at or to take first."""
    if os.getuid():
        pytest.skip("needs root, to be somebody else")
    with closing(RunFolder()) as folder, socket.socket(socket.AF_UNIX) as router:
        path = folder.endpoint.removeprefix("unixsock-stream/")
        router.bind(path)
        router.listen()
        for user, expected in ((0, 0), (65534, 1)):
            child = os.fork()
            if child == 0:
                status = 2
                with suppress(BaseException):
                    os.setuid(user)
                    with socket.socket(socket.AF_UNIX) as stranger:
                        try:
                            stranger.connect(path)
                            status = 0
                        except PermissionError:
                            status = 1
                os._exit(status)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == expected


def ended(process: psutil.Process) -> bool:
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.slow
def test_half_open_connections_keep_nobody_out(tmp_path: Path) -> None:
    """Where a run has a port, somebody without a login holds 300 connections to it. An agent that is killed is followed
    by another one all the same."""
    port = free_port()
    arguments = ["--port", str(port), "--speed", "5", "--duration", "20 s"]
    settings = ["--set", "faults=[{at: 10 s, for: 200 ms, kill: 3}]", "--set", "checks={}"]
    with LiveRun(tmp_path / "runs", "paper", *arguments, *settings) as run, ExitStack() as held:
        run.until_running(0.5)
        first = run.role("agent 3")
        for _ in range(300):
            held.enter_context(socket.create_connection(("127.0.0.1", port)))
        wait_for(lambda: ended(first), 60.0, "the fault")
        assert run.status() == 0, run.printed
        assert (run.directory / "log" / "agent-3.log").read_text() == ""


# --- the environment -------------------------------------------------------


@pytest.mark.slow
def test_zenohs_variables_in_the_environment_do_nothing(tmp_path: Path) -> None:
    """Zenoh panics on a malformed ZENOH_RUNTIME."""
    environment = {"ZENOH_RUNTIME": "garbage", "ZENOH_CONFIG": "/nowhere", "RUST_LOG": "=garbage["}
    with LiveRun(
        tmp_path / "runs", "paper", "--duration", "200 ms", "--set", "checks={}", environment=environment
    ) as run:
        assert run.status() == 0, run.printed
    out = tmp_path / "x.mcap"
    words = ["record", "--connect", "tcp/127.0.0.1:1", "--key", "a", "-o", out]
    done = fleet_process(*words, environment=environment)
    assert "tcp/127.0.0.1:1" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr
    assert "panic" not in done.stderr


def test_who_cannot_join_says_so_in_a_line(tmp_path: Path) -> None:
    """In its log, which the console quotes from."""
    ended: SimpleQueue[Exit] = SimpleQueue()
    children = Children(ended.put)
    log = tmp_path / "agent-1.log"
    join = partial(Bus.connect, "tcp/127.0.0.1:1", Credentials("agent-1", "x"), timeout_ms=100)
    try:
        children.start("agent-1", "fleet agent 1 [test]", log, join)
        children.watch()
        assert ended.get(timeout=120).code == 1
    finally:
        children.stop()
    assert log.read_text().startswith("cannot join the run at tcp/127.0.0.1:1 as agent-1: nobody listens there")
    assert len(log.read_text().splitlines()) == 1
