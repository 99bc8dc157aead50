"""Runs over several hosts: certificates, where the router listens, whose router it is, what an eavesdropper sees."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import stat
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from live import LiveRun
from repository import ROOT
from waiting import wait_for

from agents.join_file import JoinFile
from fleet.cli.hosts import meeting
from fleet.cli.main import cli
from fleet.hosts import certificates, router_config
from fleet.hosts.certificates import CertsError
from fleet.hosts.rendezvous import (
    HostsError,
    Rendezvous,
    listening,
    parse_endpoint,
    read_credentials,
    run_id,
    through_router,
)
from fleet.run.connection import ask, find
from fleet.scenario.loading import load_scenario
from netem.errors import BusError
from netem.whole_file import write_whole
from netem.wire.access import Credentials, Listener, agent_role, generate
from netem.wire.bus import Bus
from netem.wire.codec import decode
from netem.wire.keys import Keys
from netem.wire.linger import never_linger
from netem.wire.messages import End

x509 = pytest.importorskip("cryptography.x509", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")
KEYS = Keys("5ea")
LIMIT_S = 20.0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("pki") / "certs"
    certificates.make(directory, ["Sea.example.org", "192.0.2.7", "2001:db8::7"], agents=2)
    return directory


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


# Certificates


def test_certificates_are_for_the_hosts_and_keys_are_ours_alone(made: Path) -> None:
    server = certificates.read_server(made)
    assert server.hosts == ("sea.example.org", "192.0.2.7", "2001:db8::7", "localhost", "127.0.0.1")
    keys = sorted(file.name for file in made.glob("*-key.pem"))
    assert keys == ["agent-1-key.pem", "agent-2-key.pem", "fleet-key.pem", "server-key.pem"]  # and none of the CA
    assert {stat.S_IMODE((made / name).stat().st_mode) for name in keys} == {0o600}
    assert stat.S_IMODE(made.stat().st_mode) == 0o700
    certificate = x509.load_pem_x509_certificate((made / "server.pem").read_bytes())
    now = datetime.now(UTC)  # noqa: TID251
    assert certificate.not_valid_before_utc < now - timedelta(minutes=50)  # for a client whose clock is late
    assert timedelta(days=364) < certificate.not_valid_after_utc - now <= timedelta(days=365)
    assert server.pair.key not in repr(server)


def test_nothing_is_replaced_unless_forced(made: Path, tmp_path: Path) -> None:
    before = {file.name: file.read_bytes() for file in made.iterdir()}
    with pytest.raises(CertsError, match=r"holds ca\.pem, server\.pem.*--force"):
        certificates.make(made)
    assert before == {file.name: file.read_bytes() for file in made.iterdir()}
    certificates.make(tmp_path / "a")
    first = (tmp_path / "a" / "ca.pem").read_bytes()
    certificates.make(tmp_path / "a", force=True)
    assert (tmp_path / "a" / "ca.pem").read_bytes() != first
    assert certificates.read_server(tmp_path / "a").hosts == certificates.ALWAYS


def _other_ca(directory: Path) -> None:
    certificates.make(directory.parent / "other")
    (directory / "ca.pem").write_bytes((directory.parent / "other" / "ca.pem").read_bytes())


DAMAGES: dict[str, tuple[Any, str]] = {
    "no CA": (lambda d: (d / "ca.pem").unlink(), r"ca\.pem is missing; make it: fleet certs"),
    "no key": (lambda d: (d / "server-key.pem").unlink(), r"server-key\.pem is missing"),
    "key for all": (lambda d: (d / "server-key.pem").chmod(0o644), "can be read by others .*chmod 600"),
    "no PEM": (lambda d: (d / "server.pem").write_bytes(b"\xff\x00"), "is not PEM"),
    "no certificate": (lambda d: (d / "server.pem").write_text("x"), "holds no certificate in PEM"),
    "no private key": (lambda d: (d / "server-key.pem").write_text("x"), "holds no private key"),
    "another CA": (lambda d: _other_ca(d), r"server\.pem was not signed by .*ca\.pem.*--force"),
    "another key": (
        lambda d: (d / "server-key.pem").write_bytes((d / "agent-1-key.pem").read_bytes()),
        "is not the key of",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_certificates_that_cannot_work_are_refused_with_the_cure(damage: str, tmp_path: Path) -> None:
    certificates.make(tmp_path / "c", agents=1)
    act, words = DAMAGES[damage]
    act(tmp_path / "c")
    with pytest.raises(CertsError, match=words):
        certificates.read_server(tmp_path / "c")


def test_a_certificate_out_of_date_is_refused(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Later(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Later:
            return cls.fromtimestamp(datetime.now(tz).timestamp() + 366 * 86400, tz)  # noqa: TID251

    monkeypatch.setattr(certificates, "datetime", Later)
    with pytest.raises(CertsError, match=r"is valid from .* now it is .*--force"):
        certificates.read_server(made)


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "key.pem"
    write_whole(file, b"old")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("netem.whole_file.os.replace", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(file, b"new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("key.pem", b"old")]


@pytest.mark.parametrize("text", ["", "a b", "tls/x:1", "x:7447", "0.0.0.0", "::", "1.2.3", "-x", "a..b", "é"])
def test_what_is_no_host_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(CertsError):
        certificates.make(tmp_path / "c", [text])
    assert not (tmp_path / "c").exists()


# Endpoints and options


@given(st.sampled_from(["tcp", "tls"]), st.ip_addresses() | st.from_regex(r"[a-z]{1,9}(\.[a-z]{1,5})?", fullmatch=True),
       st.integers(1, 65535))  # fmt: skip
def test_an_endpoint_reads_back(protocol: str, host: Any, port: int) -> None:
    text = f"{protocol}/{f'[{host}]' if ':' in str(host) else host}:{port}"
    assert str(parse_endpoint(text, "--listen")) == text
    assert parse_endpoint(str(parse_endpoint(text, "")), "") == parse_endpoint(text, "")


@given(st.text(max_size=30))
def test_any_other_text_is_refused_in_words(text: str) -> None:
    with contextlib.suppress(HostsError):
        assert parse_endpoint(text, "--listen").port


def test_agents_are_told_what_the_certificate_holds(made: Path) -> None:
    everywhere = listening("tls/0.0.0.0:7447", made)
    assert everywhere.reached == "tls/sea.example.org:7447,tls/192.0.2.7:7447,tls/[2001:db8::7]:7447"
    assert (
        everywhere.ca == (made / "ca.pem").read_text()
        and everywhere.listener
        and everywhere.listener.certified == set()
    )
    assert listening("tls/192.0.2.7:1", made).reached == "tls/192.0.2.7:1"
    assert listening("tls/0.0.0.0:1", made, ["SEA.example.org"]).reached == "tls/sea.example.org:1"
    with pytest.raises(HostsError, match=r"not for 192\.0\.2\.8.*fleet certs .* --host 192\.0\.2\.8 --force"):
        listening("tls/0.0.0.0:1", made, ["192.0.2.8"])


def test_clear_text_is_warned_of_beyond_this_host() -> None:
    assert "not encrypted" in listening("tcp/192.0.2.7:1").warnings[0]
    assert not listening("tcp/127.0.0.1:1").warnings
    assert listening("tcp/0.0.0.0:1", advertise=["sea", "192.0.2.7"]).reached == "tcp/sea:1,tcp/192.0.2.7:1"


def test_listening_for_nobody_is_warned_of(made: Path) -> None:
    for overrides, warned in (([], True), (["external=true"], False)):
        options = {
            "listen": f"tls/127.0.0.1:{free_port()}",
            "certs": made,
            "advertise": (),
            "mutual_tls": False,
            "lease": 2000,
        }
        found = meeting(
            load_scenario("paper", overrides), options | {"router": None, "credentials": None}, in_process=False
        )
        assert found and ["no vehicle is external" in warning for warning in found.warnings] == [True] * warned


def test_mutual_tls_takes_the_external_agents_certificates(made: Path) -> None:
    found = listening("tls/0.0.0.0:1", made, external=[2], mutual=True)
    assert found.listener and found.listener.certified == {"agent-2"}
    assert found.certificates["agent-2"].certificate == (made / "agent-2.pem").read_text()
    with pytest.raises(CertsError, match=r"agent-3\.pem is missing; make it: fleet certs .* --agents 3"):
        listening("tls/0.0.0.0:1", made, external=[3], mutual=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--certs", "c"], "--certs needs --listen or --router"),
        (["--listen", "tls/0.0.0.0:7447"], "needs certificates: make them with fleet certs"),
        (["--listen", "tcp/127.0.0.1:1", "--certs", "c"], "are for tls: --listen tls/127.0.0.1:1"),
        (["--listen", "udp/127.0.0.1:1"], "--listen: expected tls/HOST:PORT"),
        (["--listen", "tcp/127.0.0.1:1", "--router", "tcp/127.0.0.1:2"], "either --listen or --router"),
        (["--listen", "tcp/127.0.0.1:1", "--credentials", "f"], "--credentials is for --router"),
        (["--router", "tcp/127.0.0.1:2"], "--router needs --credentials FILE, which fleet acl"),
        (["--router", "tcp/127.0.0.1:2", "--credentials", "f"], "f cannot be read: No such file"),
        (["--router", "tcp/0.0.0.0:2", "--credentials", "f"], "is where one listens"),
        (["--router", "tcp/a:2", "--credentials", "f", "--advertise", "x"], "--advertise is for --listen"),
        (["--listen", "tcp/192.0.2.7:7447"], "cannot be used (Cannot assign requested address)"),
        (["--listen", "tcp/127.0.0.1:1", "--in-process"], "a run in one process has no router"),
        (["--listen", "tcp/127.0.0.1:1", "--lease", "1 s"], "expected 2 s to 1800 s"),
        (["--listen", "tcp/127.0.0.1:1", "--lease", "60 s"], "--set stall_timeout"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arguments: list[str], words: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["run", "paper", "--out", str(tmp_path / "runs"), *arguments])
    assert done.exit_code == 2 and words in " ".join(done.output.split()), done.output
    assert not (tmp_path / "runs").exists()


# A router that is there already


def test_acl_prints_no_password_and_writes_them_for_us_alone(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "acl"
    arguments = ["acl", "paper", "--certs", str(made), "--run", "trial"]
    printed = CliRunner().invoke(cli, arguments)
    written = CliRunner().invoke(cli, [*arguments, "-o", str(out)])
    assert printed.exit_code == written.exit_code == 0, printed.output + written.output
    run, credentials = read_credentials(out / router_config.CREDENTIALS, 4)
    assert run == "trial" and credentials["agent-3"].user == "trial-agent-3"
    users = dict(line.split(":") for line in (out / router_config.USERS).read_text().splitlines())
    assert users == {c.user: c.password for c in credentials.values()}
    secrets = [*users.values(), (made / "server-key.pem").read_text().splitlines()[1]]
    public = printed.output + written.output + (out / router_config.CONFIG).read_text()
    assert len(set(secrets)) == 9 and not [secret for secret in secrets if secret in public]
    assert {stat.S_IMODE((out / name).stat().st_mode) for name in (router_config.USERS, router_config.CREDENTIALS)} == {
        0o600
    }
    again = CliRunner().invoke(cli, [*arguments, "-o", str(out)])
    assert again.exit_code == 2 and "--force" in again.output
    assert read_credentials(out / router_config.CREDENTIALS, 4)[1] == credentials


def test_credentials_of_another_run_are_refused(tmp_path: Path) -> None:
    router_config.write(tmp_path, "a", 3, "")
    with pytest.raises(HostsError, match="made for 3 vehicles, and the scenario has 4"):
        read_credentials(tmp_path / router_config.CREDENTIALS, 4)
    (tmp_path / router_config.CREDENTIALS).chmod(0o640)
    with pytest.raises(HostsError, match="can be read by others"):
        read_credentials(tmp_path / router_config.CREDENTIALS, 3)
    for text in (
        "",
        "[]",
        '{"run": 1}',
        '{"run": "a", "vehicles": 1, "users": {"world": 3}}',
        '{"run": 1, "vehicles": 1e999}',
        "[" * 9999,
    ):
        (tmp_path / "f").write_text(text)
        (tmp_path / "f").chmod(0o600)
        with pytest.raises(HostsError, match="no credentials file"):
            read_credentials(tmp_path / "f", 1)
    for text in ("", "a/b", "*", "a b", "ü", "x" * 65):
        with pytest.raises(HostsError, match="--run"):
            run_id(text)


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


def test_a_run_through_a_router_has_the_digest_of_one_without(made: Path, tmp_path: Path) -> None:
    """Everyone is a client there, the world too, with certificates of both sides; the log does not show it."""
    port, out = free_port(), tmp_path / "acl"
    endpoint = f"tls/127.0.0.1:{port}"
    common = ["paper", "--duration", "1 s", "--set", "checks={}", "--quiet", "--out", str(tmp_path / "runs")]
    written = CliRunner().invoke(
        cli, ["acl", "paper", "-o", str(out), "--listen", endpoint, "--certs", str(made), "--mutual-tls"]
    )
    assert written.exit_code == 0, written.output
    through = [
        "--router",
        endpoint,
        "--credentials",
        str(out / router_config.CREDENTIALS),
        "--certs",
        str(made),
        "--mutual-tls",
    ]
    with router(out / router_config.CONFIG):
        run = [sys.executable, "-m", "fleet", "run", *common, *through]
        done = subprocess.run(run, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "runs" / "latest" / "result.json").read_text())
    left = b"".join(file.read_bytes() for file in (tmp_path / "runs").rglob("*") if file.is_file())
    _, credentials = read_credentials(out / router_config.CREDENTIALS, 4)
    assert not [c.user for c in credentials.values() if c.password.encode() in left]
    alone = [sys.executable, "-m", "fleet", "run", *common, "--in-process"]
    assert subprocess.run(alone, capture_output=True, timeout=60, check=False).returncode == 0
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


def test_a_router_serves_one_run_of_an_id_at_a_time(tmp_path: Path) -> None:
    """The second would mix its messages with the first's."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    text = router_config.config(
        "twice", 1, endpoint, str(tmp_path / router_config.USERS), None, mutual=False, lease_ms=20_000
    )
    router_config.write(tmp_path, "twice", 1, text)
    found = through_router(endpoint, tmp_path / router_config.CREDENTIALS, 1)
    assert found.credentials
    with router(tmp_path / router_config.CONFIG):
        world, console = (Bus.connect(endpoint, found.credentials[role]) for role in ("world", "console"))
        world.token(Keys("twice").alive("world"))
        wait_for(lambda: console.tokens(Keys("twice").alive("*")), LIMIT_S, "the world's token")
        out = ["--set", "vehicles=1", "--out", str(tmp_path / "runs"), "--quiet"]
        run = ["run", "paper", "--router", endpoint, "--credentials", str(tmp_path / router_config.CREDENTIALS), *out]
        done = subprocess.run([sys.executable, "-m", "fleet", *run], capture_output=True, timeout=60, check=False)
        assert done.returncode == 3 and b"run twice is going on" in done.stderr, done.stderr
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


def test_who_comes_back_after_his_death_is_sent_away(tmp_path: Path) -> None:
    """A session of zenoh links again by itself, with its token: it must not hold the place of the next agent."""
    arguments = [
        "--duration",
        "4 s",
        "--speed",
        "2",
        "--set",
        "checks={tumbled: waived, deaths: {at_most: 1}}",
        "--set",
        "per_vehicle={1: {external: true}}",
    ]
    with LiveRun(tmp_path, "paper", *arguments) as run:
        file = tmp_path / "latest" / "join-1.json"
        wait_for(file.exists, LIMIT_S, "the join file")
        joining, keys = JoinFile.read(file), Keys(JoinFile.read(file).run)
        agent = subprocess.Popen(
            [sys.executable, "-m", "fleet", "agent", "--join", str(file)], stderr=subprocess.DEVNULL
        )
        run.until_running(1.0)
        agent.send_signal(signal.SIGKILL)
        agent.wait(LIMIT_S)
        found = find(run.directory, tmp_path)
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


# The page


def test_the_page_names_options_that_there_are() -> None:
    page = (ROOT / "docs" / "guide" / "hosts.md").read_text()
    named = {command: set() for command in ("run", "certs", "acl", "agent")}
    for command, rest in re.findall(r"\bfleet (run|certs|acl|agent) ([^`#\n]*)", page):
        named[command] |= set(re.findall(r"--[a-z-]+", rest))
    assert {"--listen", "--router", "--certs"} <= named["run"] and named["agent"] == {"--join"}
    for command, options in named.items():
        known = {option for parameter in cli.commands[command].params for option in parameter.opts}
        assert options <= known, command


def test_the_pages_service_is_one(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    unit = re.findall(r"```ini\n(.*?)```", (ROOT / "docs" / "guide" / "hosts.md").read_text(), re.DOTALL)
    assert len(unit) == 1 and unit[0].count("/opt/fleet/bin/fleet") == 1
    file = tmp_path / "fleet-agent@.service"
    file.write_text(unit[0].replace("/opt/fleet/bin/fleet", sys.executable))  # it must exist
    verify = ["systemd-analyze", "verify", "--man=no", str(file)]
    done = subprocess.run(verify, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_that_holds_secrets_shows_them() -> None:
    secret = Credentials("u", "swordfish", key="-----KEY-----")
    values = [
        secret,
        Rendezvous(credentials={agent_role(1): secret}, listener=Listener((), 1, key="-----KEY-----")),
        [secret],
    ]
    assert "swordfish" not in f"{values}" and "-----KEY-----" not in f"{values}"
    assert Credentials.from_values(secret.to_values() | {"more": 1}) == secret
    assert secret.to_values() == {"user": "u", "password": "swordfish", "key": "-----KEY-----"}
