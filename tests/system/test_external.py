"""Agents that somebody else starts: they join real runs, leave them, and are waited for.

What our own agent does in another terminal must be what it would have done as a child: same digest. Whatever else
happens, nobody hangs, and who is at fault is told in a sentence.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from in_process_runs import recorded
from live import LiveRun
from msgspec.structs import replace
from refusals import check_refusals
from tool import tool as op
from waiting import wait_for

from agents.join import serve
from agents.join_file import JoinFile, NotYetError
from fleet.errors import FleetError
from fleet.mcap.reader import digest
from fleet.result.result import Status
from fleet.scenario.loading import load_scenario, parse_scenario
from netem.wire.messages import PROTOCOL_VERSION

SHORT = ["duration=2 s", "checks={tumbled: waived}"]
EXTERNAL = "per_vehicle={3: {external: true}}"
READY_S = 60.0


def sets(*overrides: str) -> list[str]:
    return [part for override in overrides for part in ("--set", override)]


def agent(file: Path, *more: str) -> subprocess.Popen[str]:
    """`fleet agent --join FILE`, as in another terminal."""
    process = subprocess.Popen(
        [sys.executable, "-m", "fleet", "agent", "--join", str(file), *more],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    _started.append(process)
    return process


_started: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def nobody_stays() -> Iterator[None]:
    """A test that fails leaves no agent behind."""
    yield
    while _started:
        process = _started.pop()
        process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    said, _ = process.communicate(timeout=READY_S)
    return process.returncode, said


def join_file(run: LiveRun, incarnation: int = 0) -> Path:
    """The join file of vehicle 3 once the run waits for that life of its agent."""
    path = run.out / "latest" / "join-3.json"

    def written() -> bool:
        assert not run.over, run.printed
        return path.exists() and json.loads(path.read_text())["incarnation"] == incarnation

    wait_for(written, READY_S, "the join file")
    return path


def reference(tmp_path: Path, *overrides: str) -> str:
    """The digest of the same scenario with our agents only, in one process."""
    return recorded(tmp_path / "reference", "paper", *overrides).digest


def test_who_joins_is_the_agent_that_would_have_been_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same digest; and on the way: a wrong password, a second agent, and the file after the end."""
    expected = reference(tmp_path, *SHORT)
    with LiveRun(tmp_path / "runs", "paper", *sets(*SHORT, EXTERNAL)) as run:
        path = join_file(run)
        assert path.stat().st_mode & 0o777 == 0o600
        values = json.loads(path.read_text())
        assert set(values) == {
            "endpoint", "run", "vehicle", "user", "password", "version", "scenario", "incarnation", "begin",
        }  # fmt: skip
        assert (values["vehicle"], values["user"], values["begin"]) == (3, "agent-3", 0)
        monkeypatch.setattr("agents.join.CONNECT_MS", 300)  # after which it gives up
        with pytest.raises(NotYetError, match="refuses agent-3: the password is wrong"):
            serve(JoinFile(values["endpoint"], values["run"], 3, "agent-3", "guess"), print)
        kept = tmp_path / "kept.json"
        JoinFile(**values).write(kept)
        code, said = ended(agent(path))
        assert (code, said.splitlines()[-1]) == (0, "agent 3: the run is over")
        assert run.status() == 0, run.printed
        assert not path.exists()
        assert "waiting for agent 3 (external): fleet agent --join " in run.said
        assert digest(run.log) == expected
        code, said = ended(agent(kept))
        assert (code, "there is no router at" in said, said.count("\n")) == (2, True, 1), said


@pytest.mark.slow
def test_one_that_waits_is_started_before_its_run(tmp_path: Path) -> None:
    """The file is then that of a run that is over; the next run's is another one in the same place."""
    expected, latest = reference(tmp_path, *SHORT), tmp_path / "runs" / "latest"
    (tmp_path / "runs" / "old").mkdir(parents=True)
    latest.symlink_to("old")
    JoinFile(f"unixsock-stream/{tmp_path}/gone", "old", 3, "agent-3", "guess").write(latest / "join-3.json")
    waiting = agent(latest / "join-3.json", "--wait")
    assert waiting.stdout is not None
    assert "waiting, at most 300 s: there is no router at" in waiting.stdout.readline()
    with LiveRun(tmp_path / "runs", "paper", *sets(*SHORT, EXTERNAL)) as run:
        code, said = ended(waiting)
        assert (code, said.splitlines()[-1]) == (0, "agent 3: the run is over")
        assert run.status() == 0, run.printed
        assert digest(run.log) == expected


@pytest.mark.slow
def test_who_waits_can_be_told_to_stop(tmp_path: Path) -> None:
    file = tmp_path / "join-3.json"
    waiting = agent(file, "--wait", "1 h")
    assert waiting.stdout is not None
    assert f"waiting, at most 3600 s: there is no {file}" in waiting.stdout.readline()
    waiting.send_signal(signal.SIGINT)
    code, said = ended(waiting)
    assert (code, said.splitlines()[-1]) == (130, f"not waiting for {file} any longer")


@pytest.mark.slow
def test_a_killed_one_is_sent_away_and_another_life_joins(tmp_path: Path) -> None:
    """A scripted kill with an end: two lives of agent 3, started by hand, give the log of two of our own."""
    faults = "faults=[{at: 500 ms, for: 500 ms, kill: 3}]"
    expected = reference(tmp_path, *SHORT, faults)
    with LiveRun(tmp_path / "runs", "paper", *sets(*SHORT, EXTERNAL, faults)) as run:
        code, said = ended(agent(join_file(run)))
        assert (code, said.splitlines()[-1]) == (3, "agent 3: it was killed by a fault of the scenario or the operator")
        code, said = ended(agent(join_file(run, incarnation=1)))
        assert (code, said.splitlines()[-1]) == (0, "agent 3: the run is over")
        assert run.status() == 0, run.printed
        assert digest(run.log) == expected


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["continue", "restart", "abort"])
def test_one_that_leaves(policy: str, tmp_path: Path) -> None:
    """Ctrl-C at `fleet agent`: its token goes, and `on_death` says what follows."""
    arguments = sets("duration=4 s", "checks={tumbled: waived, deaths: {at_most: 1}}", EXTERNAL, f"on_death={policy}")
    with LiveRun(tmp_path / "runs", "paper", *arguments, "--speed", "0.05") as run:
        first = agent(join_file(run))
        wait_for(lambda: "agent 3 (external) has joined" in run.printed, READY_S, "agent 3")
        # Until then another one may come in its place, whatever the policy.
        wait_for(lambda: op(tmp_path / "runs", "status").exit_code == 0, READY_S, "the run to begin")
        if policy == "continue":
            code, said = ended(agent(join_file(run)))
            assert (code, "does not wait for an agent 3: one has joined already" in said) == (2, True), said
        first.send_signal(signal.SIGINT)
        code, said = ended(first)
        assert (code, said.splitlines()[-1]) == (130, "left the run")
        if policy != "abort":
            assert op(tmp_path / "runs", "clock", "speed", "max").exit_code == 0
        if policy == "restart":
            assert ended(agent(join_file(run, incarnation=1)))[0] == 0
        assert run.status() == (3 if policy == "abort" else 0), run.printed
        result = json.loads((run.directory / "result.json").read_text())
        if policy == "abort":
            assert result["reason"].startswith("agent 3 (external) left at t = ")
        else:
            assert result["deaths"] == {"3": ["left: its session ended"]}
            assert "agent 3 (external) left: its vehicle drifts without thrust" in " ".join(result["notes"])
            assert "death-3" in [fault["fault"] for fault in result["faults"]]


def test_nobody_comes(tmp_path: Path) -> None:
    """The run ends, says for whom it waited, and leaves no credentials behind."""
    result = recorded(tmp_path, "paper", *SHORT, EXTERNAL, in_process=False, join_timeout_s=0.3)
    assert result.status is Status.BROKEN
    assert "agent 3 (external) did not join within 0.3 s" in result.reason
    assert not (result.directory / "join-3.json").exists()


def test_nobody_can_join_a_run_in_one_process(tmp_path: Path) -> None:
    words = r"^vehicle 3 is external: a run in one process cannot have agents that are started elsewhere"
    with pytest.raises(FleetError, match=words):
        recorded(tmp_path, "paper", EXTERNAL)
    assert list(tmp_path.iterdir()) == []


def test_external_is_of_a_vehicle_or_of_all() -> None:
    """Merged as every other key that may be per vehicle; the merged scenario says the same again."""
    one = load_scenario("paper", [EXTERNAL])
    assert one.external == (3,)
    rest = load_scenario("paper", ["external=true", "per_vehicle={'1-2': {external: false}}"])
    assert rest.external == (3, 4)
    assert load_scenario("paper").external == ()
    for scenario in (one, rest):
        assert parse_scenario(scenario.to_yaml(), "again.yaml") == scenario


GOOD = {"endpoint": "tcp/127.0.0.1:1", "run": "ab", "vehicle": 3, "user": "agent-3", "password": "x"}
GOOD["version"] = PROTOCOL_VERSION


def test_what_is_wrong_with_a_join_file(tmp_path: Path) -> None:
    """Each entry is what is changed (+) in a good one, or the whole file, and its mode."""
    path = tmp_path / "join-3.json"

    def read(change: str, mode: str = "600") -> None:
        path.unlink(missing_ok=True)
        if change != "no file":
            path.write_text(json.dumps(GOOD | json.loads(change[2:])) if change.startswith("+ ") else change)
            path.chmod(int(mode, 8))
        JoinFile.read(path)

    check_refusals("agents/join files", read, hide={str(tmp_path): "HERE"})


def test_a_join_file_round_trips(tmp_path: Path) -> None:
    path = tmp_path / "join-7.json"
    joining = JoinFile("tls/host:7447", "ab", 7, "agent-7", "secret", scenario="s", incarnation=2, begin=40)
    joining = replace(joining, ca="-----BEGIN CERTIFICATE-----")
    joining.write(path)
    joining.write(path)  # it replaces the one that was there
    assert path.stat().st_mode & 0o777 == 0o600
    assert JoinFile.read(path) == joining
    assert "secret" not in repr(joining)
    several = replace(joining, endpoint="tls/[::1]:7447#iface=lo,tcp/host:1")  # as zenoh writes them
    several.write(path)
    assert JoinFile.read(path) == several
    assert [entry.name for entry in tmp_path.iterdir()] == ["join-7.json"]
