"""Runs over several hosts: where the router listens, whose router it is, what an eavesdropper sees."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_port
from host_certificates import made as made
from live import LiveRun
from refusals import check_refusals
from spawned import fleet
from tool import invoke
from waiting import wait_for

from agents.join_file import JoinFile
from fleet.addons.hosts import certificates, router_config
from fleet.addons.hosts.rendezvous import join_router, read_credentials, run_id
from fleet.errors import FleetError
from fleet.execution.connection import ask, find
from netem.errors import BusError
from netem.wire.bus import Bus
from netem.wire.codec import decode
from netem.wire.credentials import Credentials, Listener, generate
from netem.wire.keys import Keys
from netem.wire.linger import never_linger
from netem.wire.messages import End

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")

KEYS = Keys("5ea")
LIMIT_S = 60.0


def test_credentials_of_another_run_are_refused(tmp_path: Path) -> None:
    router_config.write(tmp_path, "a", 3, "")
    with pytest.raises(FleetError, match="made for 3 vehicles, and the scenario has 4"):
        read_credentials(tmp_path / router_config.CREDENTIALS, 4)
    (tmp_path / router_config.CREDENTIALS).chmod(0o640)
    with pytest.raises(FleetError, match="can be read by others"):
        read_credentials(tmp_path / router_config.CREDENTIALS, 3)

    def read(text: str) -> None:
        (tmp_path / "f").write_text(text)
        (tmp_path / "f").chmod(0o600)
        read_credentials(tmp_path / "f", 1)

    check_refusals("hosts/credentials", read, hide={str(tmp_path): "HERE"})
    check_refusals("hosts/names of runs", run_id)
    with pytest.raises(FleetError, match="no credentials file"):
        read("[" * 9999)


ROUTER = """
import sys, zenoh
session = zenoh.open(zenoh.Config.from_file(sys.argv[1]))
print("up", flush=True)
sys.stdin.read()
"""


@contextmanager
def router(config: Path) -> Iterator[None]:
    """A zenoh router with this very configuration file, as zenohd would be."""
    with subprocess.Popen(
        [sys.executable, "-c", ROUTER, str(config)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout and process.stdout.readline() == b"up\n"
            yield
        finally:
            process.kill()


@pytest.mark.slow
def test_a_run_through_a_router_has_the_digest_of_one_without(made: Path, tmp_path: Path) -> None:
    """Everyone is a client there, the world too, with certificates of both sides; the log does not show it."""
    port, out = free_port(), tmp_path / "acl"
    endpoint = f"tls/127.0.0.1:{port}"
    common = ["paper", "--duration", "1 s", "--set", "checks={}", "--quiet", "--out", str(tmp_path / "runs")]
    written = invoke("hosts", "acl", "paper", "-o", out, "--listen", endpoint, "--certs", made, "--mutual-tls")
    assert written.exit_code == 0, written.output
    through = ["--router", endpoint, "--credentials", out / router_config.CREDENTIALS, "--certs", made, "--mutual-tls"]
    with router(out / router_config.CONFIG):
        done = fleet("run", *common, *through)
        assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "runs" / "latest" / "result.json").read_text())
    left = b"".join(file.read_bytes() for file in (tmp_path / "runs").rglob("*") if file.is_file())
    _, credentials = read_credentials(out / router_config.CREDENTIALS, 4)
    assert not [c.user for c in credentials.values() if c.password.encode() in left]
    assert fleet("run", *common, "--in-process").returncode == 0
    assert json.loads((tmp_path / "runs" / "latest" / "result.json").read_text())["digest"] == result["digest"]


def test_a_router_asks_each_role_for_its_certificate(made: Path, tmp_path: Path) -> None:
    endpoint, out = f"tls/127.0.0.1:{free_port()}", tmp_path / "acl"
    text = router_config.config("sea", 2, endpoint, str(out / router_config.USERS), made, mutual=True, lease_ms=20_000)
    router_config.write(out, "sea", 2, text)
    _, known = read_credentials(out / router_config.CREDENTIALS, 2)
    keys, ca = Keys("sea"), (made / "ca.pem").read_text()

    def connect(role: str, shows: str) -> Bus:
        pair = certificates.read_client(made, shows)
        who = Credentials(known[role].user, known[role].password, ca, pair.certificate, pair.key)
        return Bus.connect(endpoint, who)

    with router(out / router_config.CONFIG):
        console = connect("console", certificates.OWN)
        console.answer(keys.cfg("*"), lambda key, _, respond: respond(b"the slice"))
        asked = {}
        for shows in ("agent-1", certificates.OWN, "agent-2"):
            agent = connect("agent-1", shows)
            asked[shows] = agent.ask(keys.cfg(1), timeout_s=1.0)
            agent.close()
        console.close()
    assert asked == {"agent-1": b"the slice", certificates.OWN: b"the slice", "agent-2": None}


@pytest.mark.slow
def test_a_router_serves_one_run_of_an_id_at_a_time(tmp_path: Path) -> None:
    """The second would mix its messages with the first's."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    text = router_config.config(
        "twice", 1, endpoint, str(tmp_path / router_config.USERS), None, mutual=False, lease_ms=20_000
    )
    router_config.write(tmp_path, "twice", 1, text)
    found = join_router(endpoint, tmp_path / router_config.CREDENTIALS, 1)
    assert found.credentials
    with router(tmp_path / router_config.CONFIG):
        world, console = (Bus.connect(endpoint, found.credentials[role]) for role in ("world", "console"))
        world.token(Keys("twice").alive("world"))
        wait_for(lambda: console.tokens(Keys("twice").alive("*")), LIMIT_S, "the world's token")
        words = ["--set", "vehicles=1", "--out", tmp_path / "runs", "--quiet"]
        words += ["--router", endpoint, "--credentials", tmp_path / router_config.CREDENTIALS]
        done = fleet("run", "paper", *words)
        assert done.returncode == 3 and "run twice is going on" in done.stderr, done.stderr
        world.close()
        console.close()


def test_connections_are_closed_without_waiting() -> None:
    """Every TCP connection loses its SO_LINGER; no descriptor is left over, and none is closed."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as stream:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        before = os.listdir("/proc/self/fd")
        never_linger()
        assert len(os.listdir("/proc/self/fd")) == len(before)
        assert stream.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)[:4] == bytes(4)
        server.accept()[0].close()


# What a cut link leaves behind
@pytest.mark.slow
def test_who_comes_back_after_his_death_is_sent_away(tmp_path: Path) -> None:
    """A session of zenoh links again by itself, with its token: it must not hold the place of the next agent."""
    arguments = ["--duration", "4 s", "--speed", "2", "--set", "checks={tumbled: waived, deaths: {at_most: 1}}"]
    with LiveRun(tmp_path, "paper", *arguments, "--set", "per_vehicle={1: {external: true}}") as run:
        file = tmp_path / "latest" / "join-1.json"
        wait_for(file.exists, LIMIT_S, "the join file")
        joining, keys = JoinFile.read(file), Keys(JoinFile.read(file).run)
        agent = subprocess.Popen(
            [sys.executable, "-m", "fleet", "agent", "--join", str(file)], stderr=subprocess.DEVNULL
        )
        run.until_running(1.0)
        agent.send_signal(signal.SIGKILL)
        agent.wait(LIMIT_S)
        found = find(str(run.directory))
        wait_for(lambda: "death-1" in str(ask(found, "faults")), LIMIT_S, "its death")
        heard: list[bytes] = []
        ghost = Bus.connect(joining.endpoint, joining.credentials)
        ghost.subscribe(keys.nav(1), lambda _, data: heard.append(data))
        ghost.token(keys.alive("agent-1"))
        wait_for(lambda: heard, LIMIT_S, "the end")
        end = decode(heard[0])
        assert isinstance(end, End) and end.incarnation == 0 and "its link had ended" in end.reason
        ghost.close()
        assert run.status() == 0, run.printed


# What goes over the wire
class Relay:
    """A cable with an eavesdropper: passes on what comes to a port, and keeps it."""

    def __init__(self, to: int, address: str = "127.0.0.1") -> None:
        self.seen = bytearray()
        self._to = to
        self._server = socket.create_server((address, 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._to))
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pass, args=(source, sink), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                self.seen += data
                sink.sendall(data)
        except OSError:
            pass
        finally:
            source.close()
            sink.close()

    def close(self) -> None:
        self._server.close()


class Port:
    """A run's router that also listens for other hosts, behind an eavesdropper."""

    def __init__(self, protocol: str, made: Path, private: Path, certified: tuple[str, ...] = ()) -> None:
        self.port, server = free_port(), certificates.read_server(made)
        self.credentials = generate((1, 2))
        listener = Listener((f"{protocol}/127.0.0.1:{self.port}",), 20_000)
        if protocol == "tls":
            pem = (server.ca, server.pair.certificate, server.pair.key)
            listener = Listener(listener.endpoints, 20_000, *pem, certified=frozenset(certified))
        self.local = f"tcp/127.0.0.1:{free_port()}"
        self.relay = Relay(self.port)
        self.remote = f"{protocol}/127.0.0.1:{self.relay.port}"
        self.bus = Bus.host(self.local, KEYS, (1, 2), self.credentials, private, listener)
        self.bus.answer(KEYS.cfg("*"), lambda key, _, respond: respond(b"the slice for " + key.encode()))

    def user(self, role: str, **more: str) -> Credentials:
        known = self.credentials[role]
        return Credentials(known.user, known.password, **more)

    def asks(self, credentials: Credentials) -> bytes | None:
        """What agent 1 is answered; raises BusError when it is not let in."""
        bus = Bus.connect(self.remote, credentials, timeout_ms=1500)
        try:
            return bus.ask(KEYS.cfg(1), timeout_s=1.0)
        finally:
            bus.close()


@contextmanager
def opened(*arguments: Any, **more: Any) -> Iterator[Port]:
    port = Port(*arguments, **more)
    try:
        yield port
    finally:
        port.bus.close()
        port.relay.close()


def test_over_tls_an_eavesdropper_sees_nothing_and_over_tcp_no_password(made: Path, tmp_path: Path) -> None:
    ca = (made / "ca.pem").read_text()
    with opened("tcp", made, tmp_path) as port:
        agent = port.user("agent-1")
        assert port.asks(agent) == b"the slice for fleet/5ea/cfg/1"
        assert b"the slice" in port.relay.seen and b"agent-1" in port.relay.seen
        assert agent.password.encode() not in port.relay.seen  # zenoh proves that it knows it, and does not send it
    with opened("tls", made, tmp_path) as port:
        agent = port.user("agent-1", ca=ca)
        assert port.asks(agent) == b"the slice for fleet/5ea/cfg/1"
        assert port.relay.seen and not [
            word for word in (b"the slice", b"agent-1", b"fleet/", agent.password.encode()) if word in port.relay.seen
        ]


@pytest.mark.slow
def test_over_tls_only_who_has_the_certificates_is_let_in(made: Path, tmp_path: Path) -> None:
    certificates.make(tmp_path / "other", agents=2)
    ca = (made / "ca.pem").read_text()

    def shows(directory: Path, who: str) -> dict[str, str]:
        pair = certificates.read_client(directory, who)
        return {"certificate": pair.certificate, "key": pair.key}

    with opened("tls", made, tmp_path, certified=("agent-1",)) as port:
        assert port.asks(port.user("agent-1", ca=ca, **shows(made, "agent-1")))
        # Agent 2's certificate with agent 1's password opens the session, but none of agent 1's keys.
        assert port.asks(port.user("agent-1", ca=ca, **shows(made, "agent-2"))) is None
        for refused in (
            port.user("agent-1", ca=ca),
            port.user("agent-1", **shows(made, "agent-1")),
            port.user("agent-1", ca=(tmp_path / "other" / "ca.pem").read_text(), **shows(made, "agent-1")),
            port.user("agent-1", ca=ca, **shows(tmp_path / "other", "agent-1")),
        ):
            with pytest.raises(BusError) as caught:
                port.asks(refused)
            assert not [s for s in (refused.password, refused.key) if s and s in str(caught.value)]
        # A router that is reached under a name which its certificate does not hold is refused by the client.
        elsewhere = Relay(port.port, "127.0.0.2")
        with pytest.raises(BusError):
            Bus.connect(
                f"tls/127.0.0.2:{elsewhere.port}",
                port.user("agent-1", ca=ca, **shows(made, "agent-1")),
                timeout_ms=1500,
            )
        assert elsewhere.seen
        elsewhere.close()
        # The run's own processes come over loopback and need no certificate, and cannot be agent 1 there.
        local = Bus.connect(port.local, port.credentials["agent-2"])
        assert local.ask(KEYS.cfg(2)) == b"the slice for fleet/5ea/cfg/2"
        local.close()
        local = Bus.connect(port.local, port.credentials["agent-1"])
        assert local.ask(KEYS.cfg(1), timeout_s=1.0) is None
        local.close()
