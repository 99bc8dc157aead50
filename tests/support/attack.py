"""An attack on a whole run by those who hold a login."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest
from waiting import wait_for

from netem.errors import BusError
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.control import request
from netem.wire.credentials import CONSOLE, OPERATOR, Credentials, generate
from netem.wire.keys import Keys
from netem.wire.messages import Command, Hello, Note

SCENARIO = ["duration=1 s", "checks={}"]


class Attack:
    """What a run is exposed to from the moment when its connection file is written; runs in the console's process, as a
    client of the world's router like any other."""

    def __init__(self) -> None:
        self.credentials: dict[str, Credentials] = {}
        self.old = generate((1, 2, 3, 4))  # of another run
        self.stolen: list[str] = []  # what came of it
        self.exposed: list[str] = []
        self.modes: dict[str, int] = {}
        self._sessions: list[Bus] = []

    def generate(self, vehicles: tuple[int, ...], **more: Any) -> dict[str, Credentials]:
        self.credentials.update(generate(vehicles, **more))
        return self.credentials

    def __call__(self, directory: Path, values: dict[str, Any]) -> None:
        keys, endpoint = Keys(values["run"]), values["endpoint"]
        self.wait_until_up(keys, endpoint)
        self._log_in(endpoint)
        self._as_agent(keys, self._join(endpoint, "agent-3"), self._join(endpoint, "agent-3"))
        self._as_operator(keys, self._join(endpoint, OPERATOR))
        self._look_round(directory)

    def wait_until_up(self, keys: Keys, endpoint: str) -> None:
        """Return when world and netem listen: what is said before nobody hears."""
        bus = self._join(endpoint, CONSOLE)
        for key in (keys.ctl("world"), keys.ctl("netem")):
            ask = partial(bus.ask, key, request("waiting"), timeout_s=0.5)
            wait_for(ask, 60.0, f"an answer on {key}")

    def _join(self, endpoint: str, role: str) -> Bus:
        self._sessions.append(Bus.connect(endpoint, self.credentials[role]))
        return self._sessions[-1]

    def _log_in(self, endpoint: str) -> None:
        good = self.credentials
        for credentials in (
            Credentials("agent-3", "guess"),
            Credentials("agent-2", good["agent-3"].password),
            Credentials(OPERATOR, good["agent-3"].password),
            Credentials("agent-5", good["agent-3"].password),
            self.old["agent-3"],
            self.old[OPERATOR],
        ):
            with pytest.raises(BusError):
                Bus.connect(endpoint, credentials, timeout_ms=60)

    def _as_agent(self, keys: Keys, bus: Bus, ear: Bus) -> None:
        """With agent 3's own login, as one who has stolen it; agent 3 itself is there, too. A session hears itself
        whatever the router says, so another one listens."""
        session = bus._session
        hear = lambda sample: self.stolen.append(str(sample.key_expr))  # noqa: E731
        for key in ("**", f"{keys.prefix}/**", keys.rx(2), keys.nav("*"), keys.frame):
            ear._held.append(ear._session.declare_subscriber(key, hear))
        lie = lambda query: self.stolen.append(str(query.key_expr))  # noqa: E731
        for key in (keys.cfg(2), keys.ctl("world"), f"{keys.op}/**"):
            ear._held.append(ear._session.declare_queryable(key, lie))
        bus.token(keys.alive("agent-2"))
        ear._held.append(ear._session.liveliness().declare_subscriber(keys.alive("*"), hear))
        forged = encode(Command(0, 0, (1.0, 1.0, 1.0), ()))
        for key in (keys.cmd(2), keys.cmd("*"), keys.frame, keys.links, keys.round, keys.grant, keys.nav(2), "**"):
            session.put(key, forged)
        session.delete(keys.cmd(2))
        bus.publisher(keys.cmd(4))(forged)
        for key in (keys.cfg(2), keys.ctl("world"), keys.ctl("netem"), f"{keys.op}/inject", "@/*/router/**"):
            self.stolen += [key for reply in session.get(key, timeout=0.2) if reply.ok is not None]
        session.put("@/router/config/access_control", b"{}")
        # On its own keys, where the router lets it: what it says there must be about itself, and in place.
        session.put(keys.cmd(3), forged)
        session.put(keys.cmd(3), b"\xc1")
        session.put(keys.tx(3), encode(Hello("agent", 2, 7, 0, False))[:-1])
        session.put(keys.note("agent-3"), encode(Note("agent-2", 2, 0, "I am agent 2")))
        session.put(keys.note("agent-3"), encode(Note("agent-3", 2, 0, "agent 2 has failed")))
        session.put(keys.note("agent-3"), encode(Note("agent-3", 3, 0, "\x1b[2Jnothing\nhappened")))

    def _as_operator(self, keys: Keys, bus: Bus) -> None:
        """The operator may ask the console, and nobody else."""
        assert bus.ask(keys.ctl("world"), request("close"), timeout_s=0.2) is None
        bus._session.put(keys.grant, b"x")

    def _look_round(self, directory: Path) -> None:
        run = psutil.Process(os.getpid())
        for process in [run, *run.children(recursive=True)]:
            for what in ("cmdline", "environ"):
                with suppress(OSError):
                    text = Path(f"/proc/{process.pid}/{what}").read_bytes()
                    self.exposed += [f"{process.pid} {what}" for secret in self.secrets if secret in text]
            if process.pid != run.pid:
                for connection in process.net_connections("inet"):
                    self.exposed.append(f"{process.cmdline()}: {connection}")
        for path in directory.rglob("*"):
            self.modes[path.name] = stat.S_IMODE(path.lstat().st_mode)

    @property
    def secrets(self) -> list[bytes]:
        return [c.password.encode() for c in self.credentials.values()]

    def close(self) -> None:
        for session in self._sessions:
            session.close()
