"""A fleet on three hosts, which are network namespaces joined by cables that can be pulled.

`sea` holds the operator, the world and netem; the agents of vehicles 1 and 2 are on `east`, those of 3 and 4 on `west`.
A cable goes from `sea` to each of the others. Nobody of this process is on any of them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from secrets import token_hex

import pytest
from in_process_runs import recorded
from live import LiveRun
from waiting import wait_for

from fleet.addons.hosts import certificates
from fleet.repeat.verify import verify

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")
ADDRESSES = {"east": "10.231.1", "west": "10.231.2"}  # of the cable's ends: .1 is the sea
LIMIT_S = 60.0
pytestmark = pytest.mark.slow


def ip(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=check, timeout=LIMIT_S)


class Hosts:
    """Three namespaces; a host is a word that stands before a command."""

    def __init__(self) -> None:
        self._tag = f"uf{token_hex(2)}"
        self._agents: list[subprocess.Popen[str]] = []

    def build(self) -> None:
        for name in ("sea", *ADDRESSES):
            ip("netns", "add", self._space(name))
            ip("-n", self._space(name), "link", "set", "lo", "up")
        for name, network in ADDRESSES.items():
            peer = f"type veth peer sea netns {self._space(name)}".split()
            ip("link", "add", name, "netns", self._space("sea"), *peer)
            for space, link, number in (("sea", name, 1), (name, "sea", 2)):
                ip("-n", self._space(space), "addr", "add", f"{network}.{number}/24", "dev", link)
                ip("-n", self._space(space), "link", "set", link, "up")

    def on(self, name: str) -> list[str]:
        return ["ip", "netns", "exec", self._space(name)]

    def pull(self, name: str) -> None:
        """The cable to a host: both ends see that it is gone."""
        ip("-n", self._space("sea"), "link", "set", name, "down")

    def plug(self, name: str) -> None:
        ip("-n", self._space("sea"), "link", "set", name, "up")

    def agent(self, name: str, file: Path) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*self.on(name), sys.executable, "-m", "fleet", "agent", "--join", str(file)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._agents.append(process)
        return process

    def fleet(self, *words: str) -> str:
        """A command of the operator, beside the run."""
        done = subprocess.run([*self.on("sea"), sys.executable, "-m", "fleet", *words], capture_output=True, text=True,
                              timeout=120, check=False)  # fmt: skip
        return done.stdout + done.stderr

    def remove(self) -> None:
        for process in self._agents:
            with suppress(ProcessLookupError):
                process.kill()
            process.communicate()
        for name in ("sea", *ADDRESSES):
            ip("netns", "del", self._space(name), check=False)

    def _space(self, name: str) -> str:
        return f"{self._tag}-{name}"


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    if os.geteuid() != 0:
        pytest.skip("making network namespaces needs root")
    made = Hosts()
    try:
        try:
            made.build()
        except (subprocess.CalledProcessError, FileNotFoundError) as error:
            pytest.skip(f"no network namespaces here: {getattr(error, 'stderr', '') or error}")
        yield made
    finally:
        made.remove()


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    directory = tmp_path / "certs"
    certificates.make(directory, [f"{network}.1" for network in ADDRESSES.values()], agents=4)
    return directory


SHORT = ["--set", "checks={tumbled: waived, deaths: {at_most: 2}}", "--set", "external=true"]


def started(hosts: Hosts, pki: Path, out: Path, *arguments: str) -> tuple[LiveRun, dict[int, subprocess.Popen[str]]]:
    """A run whose agents are all about to join."""
    tls = ["--listen", "tls/0.0.0.0:7447", "--certs", str(pki)]
    run = LiveRun(out, "paper", *SHORT, *tls, *arguments, host=hosts.on("sea"))
    files = {i: out / "latest" / f"join-{i}.json" for i in range(1, 5)}
    wait_for(lambda: run.over or all(file.exists() for file in files.values()), LIMIT_S, "the join files")
    assert not run.over, run.printed
    return run, {i: hosts.agent("east" if i < 3 else "west", file.resolve()) for i, file in files.items()}


def reference(tmp_path: Path) -> str:
    return recorded(tmp_path / "reference", "paper", "checks={}", "duration=6 s").digest


def until_waiting(hosts: Hosts, run: LiveRun, *agents: int) -> None:
    """Until `fleet status` says that the run waits for one of these, the others, if any, behind it."""
    words = [f"waiting for agent {i} (external)" for i in agents]

    def said() -> bool:
        status = hosts.fleet("status", "--run", str(run.directory))
        return any(w in status for w in words)

    wait_for(lambda: run.over or said(), LIMIT_S, " or ".join(words))
    assert not run.over, run.printed


def test_three_hosts_and_a_pulled_cable_change_no_byte(hosts: Hosts, pki: Path, tmp_path: Path) -> None:
    """A short pull stalls the fleet, which says for whom it waits; TCP carries on where it stopped."""
    run, agents = started(hosts, pki, tmp_path / "runs", "--duration", "6 s", "--speed", "2", "--mutual-tls")
    with run:
        run.until_running(1.0)
        for process in run.family():
            assert "PRIVATE KEY" not in f"{process.cmdline()} {process.environ()}"
        hosts.pull("west")
        until_waiting(hosts, run, 3, 4)  # one of them may have answered before
        hosts.plug("west")
        assert run.status(LIMIT_S) == 0, run.printed
        said = [process.communicate(timeout=LIMIT_S)[0] for process in agents.values()]
        assert [process.returncode for process in agents.values()] == [0] * 4, said
        result = json.loads((run.directory / "result.json").read_text())
        assert result["digest"] == reference(tmp_path) and result["deaths"] == {} and result["middleware_lost"] == 0
        left = b"".join(file.read_bytes() for file in run.directory.rglob("*") if file.is_file())
        assert b"PRIVATE KEY" not in left and b"BEGIN CERTIFICATE" not in left
        assert not list(run.directory.glob("join-*.json"))
        assert "PRIVATE KEY" not in run.printed + "".join(said)


def test_a_link_that_stays_silent_is_the_death_of_its_agents(hosts: Hosts, pki: Path, tmp_path: Path) -> None:
    """They leave with their link, the others go on, others take over, and the log tells it all in ticks."""
    run, agents = started(hosts, pki, tmp_path / "runs", "--duration", "20 s", "--speed", "1", "--lease", "4 s")
    with run:
        run.until_running(1.0)
        hosts.pull("west")
        died: Callable[[], bool] = lambda: "death" in hosts.fleet("status", "--all", "--run", str(run.directory))  # noqa: E731
        wait_for(died, LIMIT_S, "the deaths")
        hosts.plug("west")
        for i in (3, 4):
            # Whoever sees it first: the agent by its lease, or the run by its own, which tells it when it is back.
            said = agents[i].communicate(timeout=LIMIT_S)[0]
            assert "the link to the run has ended" in said or "its link had ended, and its life with it" in said
            assert agents[i].returncode == 3
        assert hosts.fleet("heal", "--run", str(run.directory)).startswith(
            f"{run.directory.name}: healed death-3, death-4"
        )
        # Slow until here, so that agents can take over before it ends, however busy this machine is.
        hosts.fleet("clock", "speed", "max", "--run", str(run.directory))
        files = [run.directory / f"join-{i}.json" for i in (3, 4)]
        wait_for(
            lambda: all(json.loads(f.read_text())["incarnation"] == 1 for f in files), LIMIT_S, "their second lives"
        )
        again = [hosts.agent("west", file) for file in files]
        assert run.status(LIMIT_S) == 0, run.printed
        assert [process.wait(LIMIT_S) for process in [agents[1], agents[2], *again]] == [0] * 4
        result = json.loads((run.directory / "result.json").read_text())
        assert set(result["deaths"]) == {"3", "4"} and result["middleware_lost"] == 0, result
        assert verify(run.log).reproduced
