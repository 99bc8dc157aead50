"""The C agent of docs/examples, with a transport that can do no more than zenoh-pico: a certificate, no password, not
low-latency. The agent is a process that speaks through pipes; what they carry is kept."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from pathlib import Path
from types import TracebackType

import pytest
import zenoh
from repository import ROOT

SOURCE = ROOT / "docs" / "examples" / "c_agent"
HELLO_S = 0.05
Frame = tuple[str, bytes]  # a letter, as in pipes.c, and what it carries


def build(directory: Path) -> Path:
    """The agent for pipes, compiled with checks of memory and arithmetic; skips the test without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    program = directory / "agent_pipes"
    options = ["-std=c11", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    files = [str(SOURCE / name) for name in ("pipes.c", "agent.c", "msgpack.c", "join.c")]
    subprocess.run([compiler, *options, *checks, *files, "-lm", "-o", str(program)], check=True, timeout=120)
    return program


def session(folder: Path, *, certificate: Path | None = None) -> zenoh.Session:
    """A session with what a join folder holds and nothing else.

    Args:
        certificate: another folder, whose certificate is shown instead.

    Raises:
        zenoh.ZError: the router does not let it in.
    """
    shown = certificate or folder
    tls: dict[str, object] = {"root_ca_certificate": str(folder / "ca.pem")}
    if (shown / "certificate.pem").exists():
        tls |= {
            "enable_mtls": True,
            "connect_certificate": str(shown / "certificate.pem"),
            "connect_private_key": str(shown / "key.pem"),
        }
    settings = {
        "mode": "client",
        "connect": {"endpoints": [conf(folder)["endpoint"]], "timeout_ms": 1000, "exit_on_failure": True},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"unicast": {"lowlatency": False}, "link": {"tls": tls}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


def conf(folder: Path) -> dict[str, str]:
    """The names and values of join.conf."""
    lines = (folder / "join.conf").read_text("ascii").splitlines()
    return {name: value for name, _, value in (line.partition(" ") for line in lines)}


class CAgent:
    """The C agent in a run."""

    def __init__(self, program: Path, folder: Path) -> None:
        self._keys = keys = conf(folder)
        self.frames: list[Frame] = []  # in the order in which they passed
        self.reason = ""  # with which it was told the end
        self._lock, self._joined = threading.Lock(), threading.Event()
        self._session = session(folder)
        replies = list(self._session.get(keys["cfg"], consolidation=zenoh.ConsolidationMode.NONE))
        put = {letter: self._session.declare_publisher(keys[name]).put for letter, name in (("c", "cmd"), ("t", "tx"))}
        self._process = subprocess.Popen(
            [str(program), str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self._give("g", b"".join(reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None))
        self._held = [
            self._session.declare_subscriber(keys[name], lambda s, a=letter: self._give(a, s.payload.to_bytes()))
            for letter, name in (("n", "nav"), ("r", "rx"))
        ]
        self._put = put
        threading.Thread(target=self._greet, daemon=True).start()

    def __enter__(self) -> CAgent:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()
        self._joined.set()
        self._session.close()

    def run(self) -> int:
        """Carry what it says until it ends; its exit status."""
        while head := self._process.stdout.read(5):
            letter = chr(head[0])
            data = self._process.stdout.read(int.from_bytes(head[1:], "little"))
            with self._lock:
                self.frames.append((letter, data))
            match letter:
                case "j":
                    self._held.append(self._session.liveliness().declare_token(self._keys["alive"]))
                    self._joined.set()
                case "e":
                    self.reason = data.decode()
                case _:
                    self._put[letter](data)
        said = self._process.stderr.read()
        assert said == b"", said.decode()
        return self._process.wait(60)

    def _give(self, letter: str, data: bytes) -> None:
        with self._lock:
            if self._process.poll() is None:
                self.frames.append((letter, data))
                self._process.stdin.write(frame(letter, data))
                self._process.stdin.flush()

    def _greet(self) -> None:
        while not self._joined.wait(HELLO_S):
            self._give("h", b"")


def frame(letter: str, data: bytes) -> bytes:
    """As pipes.c reads it."""
    return letter.encode() + len(data).to_bytes(4, "little") + data
