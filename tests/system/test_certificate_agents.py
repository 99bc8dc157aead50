"""Agents that join with a certificate alone, as one on zenoh-pico must: the example in C in a real run.

zenoh-pico itself is not to be had where these tests run. The C code is the example's own; a zenoh session in Python
carries its messages, and it has no password and no low-latency transport either (tests/support/c_agent.py).
"""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
import threading
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest
import zenoh
from c_agent import CAgent, Frame, build, conf, frame, session
from free_ports import free_port
from host_certificates import made as made
from live import LiveRun
from repository import ROOT
from waiting import wait_for

from fleet.addons.hosts.protocol.conformance import CHECKS, Examination
from fleet.addons.hosts.rendezvous import listening_for_certificates
from fleet.execution.rendezvous import JoinFolder, KeyPair, Rendezvous
from fleet.scenario.loading import load_scenario
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'uuv-fleet[hosts]'")

LIMIT_S = 60.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("c-agent"))


def test_the_agent_in_c_in_a_real_run(made: Path, program: Path, tmp_path: Path) -> None:
    """It gets what its vehicle believes, and does what the agent in Python does, byte for byte. Meanwhile nobody gets
    in without a certificate, and agent 1's opens nothing of agent 2's."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    join = tmp_path / "join-2.json"
    sets = ["per_vehicle={2: {external: true, navigation: mems}}", "checks={deaths: {at_most: 0}}"]
    options = [part for value in sets for part in ("--set", value)]
    certified = ["--listen-certified", endpoint, "--certs", str(made)]
    with LiveRun(tmp_path / "runs", "paper", "--duration", "2 s", *options, *certified) as run:
        folder = run.out / "latest" / "join-2"
        wait_for(lambda: run.over or (folder / "join.conf").exists(), LIMIT_S, "the join folder")
        assert not run.over, run.printed
        folder = folder.resolve()
        join.write_text((folder.parent / "join-2.json").read_text())
        modes = {path.name: path.stat().st_mode & 0o777 for path in (folder, *folder.iterdir())}
        assert modes.pop("join-2") == 0o700
        assert modes == dict.fromkeys(("join.conf", "ca.pem", "certificate.pem", "key.pem"), 0o600)
        assert "password" not in (folder / "join.conf").read_text()
        (nobody := tmp_path / "nobody").mkdir()
        with pytest.raises(zenoh.ZError):
            session(folder, certificate=nobody)
        other = _folder_of(1, made, folder, tmp_path / "join-1")
        with CAgent(program, folder) as agent, session(folder, certificate=other) as intruder:
            heard: list[Any] = []
            for key in ("nav", "rx"):
                intruder.declare_subscriber(conf(folder)[key], heard.append)
            command = msgpack.packb(["cmd", 0, 0, [1.0, 0.0, 0.0], []])
            intruder.put(conf(folder)["cmd"], command)
            assert not list(intruder.get(conf(folder)["cfg"], timeout=0.5))
            assert agent.run() == 0
            assert agent.reason == "the run is over"
        assert run.status() == 0, run.printed
        assert not folder.exists()
        assert not heard
        result = json.loads((run.directory / "result.json").read_text())
    assert "a TLS handshake failed: peer sent no certificates" in result["rejected"]
    # A handshake may also end because the session without a certificate gives up.
    assert [said for said in (*result["rejected"], *result["notes"]) if "a TLS handshake failed: " not in said] == []
    said = [one for one in agent.frames if one[0] in "ct" and not _probe(one)]
    assert len(said) > 200
    assert said == _said_in_python(agent.frames, join)
    navs = [fields for letter, data in agent.frames if letter == "n" and (fields := msgpack.unpackb(data))[0] == "nav"]
    assert {(len(nav), len(nav[-1])) for nav in navs} == {(8, 10)}


def _folder_of(i: int, certs: Path, like: Path, path: Path) -> Path:
    """A join folder with agent i's certificate, for the run of another folder."""
    listener = listening_for_certificates(Rendezvous(), conf(like)["endpoint"], certs, external=(i,))
    folder: JoinFolder = listener.folders[i]
    folder.write(path, Keys(conf(like)["run"]), 0, 0)
    return path


def _probe(one: Frame) -> bool:
    kind, *_, echo = msgpack.unpackb(one[1])
    return kind == "hello" and not echo


def _said_in_python(frames: list[Frame], join: Path) -> list[Frame]:
    """What docs/examples/foreign_agent.py puts when it gets the same messages in the same order."""
    said: list[Frame] = []
    incoming = [(letter, data) for letter, data in frames if letter in "nr"]
    handlers: list[Any] = []

    def payload(data: bytes) -> SimpleNamespace:
        return SimpleNamespace(to_bytes=lambda: data)

    def subscribe(_: str, handler: Any) -> None:
        handlers.append(handler)
        if len(handlers) == 2:
            for _letter, data in incoming:
                handler(SimpleNamespace(payload=payload(data)))

    def publisher(key: str, **_: Any) -> SimpleNamespace:
        letter = "c" if "/cmd/" in key else "t"
        return SimpleNamespace(put=lambda data: said.append((letter, data)))

    (answer,) = [data for letter, data in frames if letter == "g"]
    fake = SimpleNamespace(
        get=lambda _: [SimpleNamespace(ok=SimpleNamespace(payload=payload(answer)))],
        declare_subscriber=subscribe,
        declare_publisher=publisher,
        liveliness=lambda: SimpleNamespace(declare_token=lambda _: None),
        close=lambda: None,
    )
    zenoh_like = SimpleNamespace(
        open=lambda _: fake,
        Config=SimpleNamespace(from_json5=lambda _: None),
        CongestionControl=SimpleNamespace(BLOCK=0),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "zenoh", zenoh_like)
        patch.setattr(sys, "argv", ["foreign_agent.py", str(join)])
        runpy.run_path(str(ROOT / "docs" / "examples" / "foreign_agent.py"))
    return [one for one in said if not _probe(one)]


def test_the_agent_in_c_passes_the_protocol_check(made: Path, program: Path, tmp_path: Path) -> None:
    meeting = listening_for_certificates(Rendezvous(), f"tls/127.0.0.1:{free_port()}", made, external=(2,))
    examination = Examination(load_scenario("paper"), 2, tmp_path / "join-2.json", meeting=meeting)
    ended: list[int] = []

    def carry() -> None:
        with CAgent(program, tmp_path / "join-2") as agent:
            ended.append(agent.run())

    started: list[threading.Thread] = []

    def start(_: str) -> None:
        started.append(threading.Thread(target=carry, daemon=True))
        started[0].start()

    found = examination.run(LIMIT_S, start)
    started[0].join(LIMIT_S)
    assert [str(check) for check in found if not check.passed] == []
    assert len(found) == len(CHECKS)
    assert ended == [0]
    assert list(tmp_path.iterdir()) == []


def test_the_agent_in_c_survives_garbage(program: Path, tmp_path: Path) -> None:
    """Cut, changed and invented messages: nothing is read or written where it should not be, which the sanitizers of
    the compiler watch."""
    JoinFolder(2, ("tls/a:1", "tls/b:1"), 1, "", KeyPair("", "")).write(tmp_path / "join-2", Keys("ab"), 0, 0)
    command = [str(program), str(tmp_path / "join-2")]
    slice_ = load_scenario("paper").agent_config(2).to_values()
    answer = msgpack.packb({"agent": slice_, "incarnation": 0, "begin": 0, "version": PROTOCOL_VERSION})
    nav = msgpack.packb(["nav", 0, 0, [0.0] * 5, [0.1] * 5])
    rx = msgpack.packb(["rx", 0, 10, False, [[10, 0, 1, 0, 0, bytes(63)]] * 3])
    hellos = [msgpack.packb(["hello", role, 0, 0, PROTOCOL_VERSION, True]) for role in ("world", "netem")]
    draw = Random(7)
    sent = [frame("g", answer), *(frame("n", hello) for hello in hellos)]
    for _ in range(3000):
        message = bytearray(draw.choice((nav, rx)))
        for _ in range(draw.randrange(4)):
            message[draw.randrange(len(message))] = draw.randrange(256)
        if draw.random() < 0.3:
            message = message[: draw.randrange(len(message))]
        sent.append(frame("n", bytes(message)))
    sent.append(frame("n", nav))
    sent.append(frame("n", msgpack.packb(["end", 0, 0, "over"])))
    done = subprocess.run(command, input=b"".join(sent), capture_output=True, timeout=LIMIT_S, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.endswith(frame("e", b"over"))
    for entry in ("", "vehicle 2\n" * 9, f"endpoint {'x' * 999}\n"):
        (tmp_path / "join-2" / "join.conf").write_text(entry)
        refused = subprocess.run(command, input=b"", capture_output=True, timeout=LIMIT_S, check=False)
        assert (refused.returncode, refused.stderr[:6]) == (2, b"usage:")
    JoinFolder(2, ("tls/a:1",), 1, "", KeyPair("", "")).write(tmp_path / "join-2", Keys("ab"), 0, 0)
    for cut in range(0, len(answer), 150):
        refused = subprocess.run(
            command, input=frame("g", answer[:cut]), capture_output=True, timeout=LIMIT_S, check=False
        )
        assert refused.returncode == 2
        assert refused.stderr.startswith(b"cfg: ")
        assert refused.stderr.count(b"\n") == 1
