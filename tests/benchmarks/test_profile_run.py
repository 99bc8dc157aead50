"""Profiles: what py-spy wrote is read and divided among the rooms; one that is missing or may not look is a line."""

from __future__ import annotations

import json
import shutil
import stat
import subprocess
from pathlib import Path
from typing import Any

import profile_run as profile
import pytest
from click.testing import CliRunner
from flame_graph import Frame
from profile_run import Times, kind_of, read_stacks
from repository import ROOT
from soak import of_session
from waiting import wait_for

import fleet
from fleet.errors import FleetError

PLACES = {
    "main": "/usr/lib/python3.11/runpy.py",
    "serve": f"{ROOT}/world/process.py",
    "advance": f"{ROOT}/world/sea.py",
    "rk4": "/x/site-packages/abc__mypyc.cpython-311-x86_64-linux-gnu.so",
    "get": f"{ROOT}/netem/wire/queues.py",
    "recv": "/x/lib/python3.11/site-packages/zenoh/zenoh.abi3.so",
    "syscall": "/usr/lib/libc.so.6",
    "compress": "/project/zstd/zstd.c",
    "_load": "<frozen importlib._bootstrap>",
    "0x7f12": "?",
}


def speedscope(*stacks: tuple[str, ...], **other: Any) -> bytes:
    names = list(PLACES)
    found = {
        "name": 'Process 7 Thread 8 "MainThread"',
        "unit": "seconds",
        "samples": [[names.index(name) for name in stack] for stack in stacks],
        "weights": [0.01] * len(stacks),
    } | other
    frames = [{"name": name, "file": file, "line": 1} for name, file in PLACES.items()]
    return json.dumps({"shared": {"frames": frames}, "profiles": [found], "exporter": "py-spy"}).encode()


@pytest.mark.parametrize(
    ("stack", "kind", "shown"),
    [
        (("main", "serve", "advance"), "world", ["process.serve", "sea.advance"]),
        (("main", "serve", "advance", "rk4"), "compiled cores", ["process.serve", "sea.advance", "rk4"]),
        (("main", "serve", "get", "recv", "syscall"), "zenoh", ["process.serve", "queues.get", "recv", "syscall"]),
        (("main", "serve", "compress"), "recorder", ["process.serve", "compress"]),
        (("main", "serve", "_load", "advance"), "imports", ["process.serve", "(imports)"]),
        (("main", "0x7f12"), "other", ["runpy.main", "?"]),
    ],
)
def test_time_belongs_to_the_innermost_function_with_a_known_place(
    stack: tuple[str, ...], kind: str, shown: list[str]
) -> None:
    ((key, ((frames, seconds),)),) = read_stacks(speedscope(stack)).items()
    assert (key, seconds) == ((7, 8), 0.01)
    assert (kind_of(frames), [frame.name for frame in frames]) == (kind, shown)


def test_our_files_are_known_where_the_package_lies() -> None:
    assert Path(fleet.__file__).parents[1] == ROOT
    assert profile._frame({"name": "f", "file": f"{ROOT}/agents/agent.py"}) == Frame("agent.f", "agent")
    assert profile._frame({"name": "f", "file": "/home/agents/lib/agents/x.py"}).kind == ""


@pytest.mark.parametrize("text", [b"", b"{}", speedscope(name="Process 7"), speedscope(unit="none")])
def test_what_another_py_spy_wrote_is_refused(text: bytes) -> None:
    with pytest.raises(FleetError, match="the profile of this py-spy cannot be read: "):
        read_stacks(text)


def test_threads_that_python_does_not_know_are_zenohs(tmp_path: Path) -> None:
    times = Times({7: "world", 9: "agents"}, {(7, 8): 1.0, (7, 80): 2.0, (9, 9): 9.0}, {(7, 8): 0.5, (7, 80): 0.5})
    times.kernel[9, 9] = 1.0
    stacks = read_stacks(speedscope(("main", "serve", "advance"), ("main", "serve", "get", "recv")))
    world, agents = profile._rows(stacks, times, tmp_path, "paper", in_process=False)
    assert (world.process, world.cpu_s, world.kernel, world.samples) == ("world", 4.0, 0.25, 2)
    # 1.5 s of the thread that was seen, half of it in zenoh, and 2.5 s of the other one.
    assert world.shares == pytest.approx({"world": 0.75 / 4, "zenoh": 3.25 / 4})
    assert (agents.process, agents.samples, agents.flame_graph) == ("agents", 0, "")
    assert (tmp_path / "world.svg").read_text("utf-8").startswith("<svg ")


@pytest.mark.parametrize(
    ("command", "role"),
    [
        (["fleet agent 3 [paper]"], "agents"),
        (["fleet world [paper]"], "world"),
        (["fleet netem [paper]"], "netem"),
        (["python", "-P", "-m", "fleet", "run", "paper"], "console"),
        (["python", "-c", "from multiprocessing.forkserver import main"], ""),
        ([], ""),
    ],
)
def test_processes_are_known_by_their_names(command: list[str], role: str) -> None:
    assert profile._role(command) == role


def test_a_child_with_its_parents_command_is_no_second_console() -> None:
    """What a fork has until it executes its own program."""
    command = ["python", "-P", "-m", "fleet", "run", "paper"]
    assert profile._role(command, above="console") == ""
    assert profile._role(["fleet", "agent", "3"], above="console") == "agents"


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(profile.main, ["paper", *arguments])
    return result.exit_code, result.stderr.strip()


def test_without_py_spy_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    status, line = run()
    assert (status, line) == (
        3, "a profile needs py-spy, which is not installed: pip install py-spy"
    )  # fmt: skip


def test_a_py_spy_that_may_not_look_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = tmp_path / "py-spy"
    refusing.write_text("#!/bin/sh\necho sampling\necho 'Permission Denied: Try running again as root' >&2\nexit 1\n")
    refusing.chmod(refusing.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(shutil, "which", lambda *_, **__: str(refusing))
    status, line = run("-o", str(tmp_path / "out"))
    assert status == 3 and "\n" not in line
    assert line.startswith("py-spy made no profile: Permission Denied: Try running again as root; ")
    assert "--cap-add SYS_PTRACE" in line
    assert not (tmp_path / "out").exists()


def test_a_run_that_breaks_is_no_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = {"status": "broken", "reason": "agent 2 was killed", "wall": {"x_real_time": 1.0, "in_process": False}}
    monkeypatch.setattr(profile, "py_spy", lambda: "true")
    monkeypatch.setattr(profile, "result_of", lambda _: broken)
    status, line = run("-o", str(tmp_path / "out"))
    assert (status, line) == (3, "the run was broken: agent 2 was killed")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("tries", [1, 2])
def test_a_run_that_stands_still_is_ended_and_made_once_more(
    tries: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """py-spy has left a process stopped for ever."""
    stuck = tmp_path / "py-spy"
    stuck.write_text(f"#!/bin/sh\necho $$ >>{tmp_path}/sessions\nsleep 60 &\nwait\n")
    stuck.chmod(0o755)
    monkeypatch.setattr(profile, "py_spy", lambda: str(stuck))
    monkeypatch.setattr(profile, "STILL_S", 0.3)
    monkeypatch.setattr(profile, "TRIES", tries)
    status, line = run("-o", str(tmp_path / "out"))
    assert (status, line) == (
        3, f"the run stood still under py-spy for 0.3 s, {tries} times: try another py-spy"
    )  # fmt: skip
    sessions = (tmp_path / "sessions").read_text().split()
    assert len(sessions) == tries
    assert [of_session(int(session)) for session in sessions] == [[]] * tries


def test_an_interrupt_lets_the_run_end_by_itself_and_leaves_nobody(tmp_path: Path) -> None:
    """The run, which is not the first of the group, gets the time to clean up that it needs."""
    script = f"(trap 'sleep 0.3; echo cleaned >{tmp_path}/said; exit' TERM; touch {tmp_path}/ready; sleep 60 & wait) &"
    session = 0

    def interrupted() -> None:
        nonlocal session
        with profile._session(["sh", "-c", f"{script} sleep 60"], subprocess.DEVNULL) as process:
            session = process.pid
            wait_for((tmp_path / "ready").exists, 60.0, "the run")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "said").read_text() == "cleaned\n"
    assert of_session(session) == []


def test_a_scenario_that_there_is_not_is_told_before_py_spy_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profile, "measure_profile", lambda *_: pytest.fail("measured"))
    result = CliRunner().invoke(profile.main, ["nosuch"])
    assert result.exit_code == 2 and "nosuch" in result.stderr


@pytest.mark.slow
@pytest.mark.skipif(profile.py_spy() is None, reason="py-spy is not installed")
def test_a_run_is_profiled_process_by_process(tmp_path: Path) -> None:
    words = ["paper", "--set", "duration=3 s", "--set", "checks={}"]
    found = profile.measure_profile(words, "paper", tmp_path)
    assert {row.process: row.processes for row in found.processes} == {
        "agents": 4,
        "console": 1,
        "netem": 1,
        "world": 1,
    }
    for row in found.processes:
        assert row.cpu_s > 0 and sum(row.shares.values()) == pytest.approx(1.0, abs=0.02)
        assert Path(row.flame_graph).stat().st_size < 300_000
