"""An agent that somebody starts, in any terminal that can reach the run: who it is, what it joins, how it ends.

`fleet run` writes a join file for every vehicle whose agent it does not start, with that agent's credentials and
nobody else's. The agent that joins with it is the one that `fleet run` would have started, to the last bit.
"""

from __future__ import annotations

import json
import os
import re
import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any

from agents.config import AgentConfig
from agents.controllers import BUILT_IN, laws
from agents.errors import AgentError, PluginError
from agents.main import begin_life
from agents.plugins import admit
from agents.trust import NOTHING, Trust
from netem.access import LEASE_MS, Credentials
from netem.bus import Bus
from netem.errors import BusError, MalformedMessage
from netem.files import open_file, read_bounded, write_whole
from netem.keys import Keys
from netem.messages import PROTOCOL_VERSION, End
from netem.shell import read_map

CONNECT_MS = 3000
MOST_TEXT = 200  # characters of a name or password
MOST_BYTES = 1_000_000  # of a join file, with certificates
ASK_S = 10.0
# As zenoh writes it; the socket is that of a run on this host, of this user.
_ENDPOINT = re.compile(r"(tcp|tls)/(?P<host>[^?#]+):(?P<port>[0-9]{1,5})([?#].*)?|unixsock-stream/(?P<path>/[^?#]+)")
_ONE_HOST = {"ca": "", "certificate": "", "key": "", "lease_ms": LEASE_MS}  # left out of the file
WATCH_S = 0.2  # how often to look whether the run is still there


class JoinError(AgentError):
    """A run that cannot be joined, or that went away: its text says why, and what to do."""


@dataclass(frozen=True, slots=True)
class Joining:
    """The content of a join file."""

    endpoint: str  # of the run's router, as zenoh writes it
    run: str  # the run's number: its keys begin with fleet/<run>/
    vehicle: int
    user: str
    password: str
    version: int = PROTOCOL_VERSION
    scenario: str = ""
    incarnation: int = 0  # which life of the agent it is
    begin: int = 0  # tick of its first nav
    ca: str = ""  # PEM, with TLS: the certificate authority to trust
    certificate: str = ""  # PEM, with its key: what to show a router that asks for it
    key: str = ""
    lease_ms: int = LEASE_MS  # how long the router keeps a silent link

    @property
    def credentials(self) -> Credentials:
        """What the router is shown."""
        return Credentials(self.user, self.password, self.ca, self.certificate, self.key, self.lease_ms)

    def __repr__(self) -> str:
        return f"Joining({self.endpoint!r}, run={self.run!r}, vehicle={self.vehicle}, password=***)"

    def write(self, path: Path) -> None:
        """Make the file, or replace it as a whole; nobody but this user can read it.

        Raises:
            OSError: it cannot be written.
        """
        values = {key: value for key, value in asdict(self).items() if value != _ONE_HOST.get(key)}
        write_whole(path, (json.dumps(values, indent=2) + "\n").encode())

    @classmethod
    def read(cls, path: Path) -> Joining:
        """The inverse of `write`.

        Raises:
            JoinError: it is not there, others can read it, it is no join file, or of another protocol version.
        """
        try:
            with open_file(path) as file:
                mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
                data = read_bounded(file, MOST_BYTES)
        except FileNotFoundError:
            raise JoinError(
                f"there is no {path}: a run writes it for each vehicle that is external, and removes it when it ends"
            ) from None
        except OSError as error:
            raise JoinError(f"{path} cannot be read: {error.strerror}") from None
        if mode & 0o077:
            raise JoinError(
                f"{path} holds a password and can be read by others (mode {mode:04o}, expected 0600): chmod 600 {path}"
            )
        try:
            values = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise JoinError(f"{path} is no join file: not JSON ({error!s:.100})") from None
        if not isinstance(values, dict):
            raise JoinError(f"{path} is no join file: expected a map, got {type(values).__name__}")
        version = values.get("version")
        if version != PROTOCOL_VERSION:
            raise JoinError(
                f"the run of {path} speaks version {version!s:.40} of the protocol, this fleet version "
                f"{PROTOCOL_VERSION}: use the uuv-fleet that the run uses"
            )
        fields: dict[str, type] = {"endpoint": str, "run": str, "vehicle": int, "user": str, "password": str}
        optional: dict[str, type] = {"scenario": str, "incarnation": int, "begin": int}
        optional |= {"ca": str, "certificate": str, "key": str, "lease_ms": int}
        for key, kind in fields.items():
            if key not in values:
                raise JoinError(f"{path} is no join file: it has no {key!r}")
            _check(path, key, kind, values[key])
        for key, kind in optional.items():
            if key in values:
                _check(path, key, kind, values[key])
        for endpoint in values["endpoint"].split(","):
            if not _ENDPOINT.fullmatch(endpoint):
                known = "tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream/PATH"
                raise JoinError(f"{path}: endpoint: expected {known}, got {endpoint!r:.80}")
        for key in ("ca", "certificate", "key"):
            if values.get(key) and "-----BEGIN " not in values[key]:
                raise JoinError(f"{path}: {key}: expected PEM, which has a line -----BEGIN ...-----")
        return cls(version=version, **{key: values[key] for key in (*fields, *optional) if key in values})


def _check(path: Path, key: str, kind: type, value: Any) -> None:
    if type(value) is not kind:
        raise JoinError(f"{path}: {key}: expected {kind.__name__}, got {type(value).__name__}")
    if isinstance(value, str) and len(value) > MOST_TEXT and key not in ("endpoint", "ca", "certificate", "key"):
        raise JoinError(f"{path}: {key}: {len(value)} characters, expected at most {MOST_TEXT}")


def serve(joining: Joining, tell: Callable[[str], None], trust: Trust = NOTHING) -> End:
    """Be that agent until the world says that no more navs will come.

    Args:
        tell: told when it has joined.
        trust: which modules of laws may run besides those that are installed: the run names them, not this user.

    Raises:
        JoinError: the run cannot be joined, expects no such agent, asks for a law that may not run, or went away.
        SystemExit: the law failed; the console has been told by then.
        KeyboardInterrupt: Ctrl-C; the session is closed.
    """
    keys = Keys(joining.run)
    bus = _connect(joining)
    lost = Event()
    bus.on_lost(lost.set)
    try:
        config, clock, incarnation, begin = _ask(bus, keys, joining.vehicle)
        _admit(config, trust)
        ended: SimpleQueue[End | BaseException] = SimpleQueue()

        def live() -> None:
            try:
                process = begin_life(bus, keys, config, clock, incarnation, begin)
                tell(f"agent {config.id} has joined run {joining.run} at {joining.endpoint}")
                ended.put(process.serve())
            except BaseException as error:  # a law may raise anything, and ends with SystemExit
                ended.put(error)

        # A thread of its own, because a signal is heard between two bytecodes only, and waiting for a nav is one.
        Thread(target=live, name="agent", daemon=True).start()
        return _outcome(lost, ended)
    finally:
        bus.close()


def _admit(config: AgentConfig, trust: Trust) -> None:
    try:
        for kind, law in laws(config).items():
            if law.name not in BUILT_IN[kind]:
                admit(kind, law.name, trust, elsewhere=[Path()], because="the run names it")
    except PluginError as error:
        raise JoinError(str(error)) from None


def _outcome(lost: Event, ended: SimpleQueue[End | BaseException]) -> End:
    """Zenoh would link to the router again by itself, and what was on the way would be missing without a word: who has
    lost its link has left the run."""
    gone = False
    while True:
        try:
            outcome = ended.get(timeout=WATCH_S)
        except Empty:
            if gone:
                raise JoinError("the link to the run has ended: its router closed it, or the line is cut") from None
            gone = lost.is_set()  # what came last may still be under way from one thread to the other
            continue
        if isinstance(outcome, BusError):
            raise JoinError(str(outcome))
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome


def _connect(joining: Joining) -> Bus:
    endpoints = joining.endpoint.split(",")
    reached = [endpoint for endpoint in endpoints if _reached(endpoint)]
    for endpoint in reached:
        with suppress(BusError):
            return Bus.connect(endpoint, joining.credentials, timeout_ms=CONNECT_MS)
    if not reached:
        where = " or ".join(endpoints)
        raise JoinError(f"nobody listens at {where}: run {joining.run} is over, or cannot be reached from here")
    tls = "its certificate is not the one to expect, or it asks for another; " if "tls/" in joining.endpoint else ""
    raise JoinError(
        f"the router at {' or '.join(reached)} does not let {joining.user} in: {tls}the password is wrong, or of "
        "another run than the one that listens there now"
    )


def _reached(endpoint: str) -> bool:
    """Whether somebody accepts connections there; true where that cannot be said."""
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None:
        return True
    try:
        if found["path"]:
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(CONNECT_MS / 1000)
                probe.connect(found["path"])
        else:
            socket.create_connection((found["host"].strip("[]"), int(found["port"])), CONNECT_MS / 1000).close()
    except (OSError, OverflowError):
        return False
    return True


def _ask(bus: Bus, keys: Keys, vehicle: int) -> tuple[AgentConfig, str, int, int]:
    """The agent's own slice, the kind of clock, which life of it this is, and the tick of its first nav."""
    answer = bus.ask(keys.cfg(vehicle), timeout_s=ASK_S)
    if answer is None:
        raise JoinError(
            f"nobody answered on {keys.cfg(vehicle)}: this login, or the certificate with it, is not that of agent "
            f"{vehicle}, or run {keys.run} is not going on there"
        )
    try:
        values = read_map(answer)
        if "error" in values:
            raise JoinError(str(values["error"]))
        clock = str(values.get("clock", "lockstep"))
        return AgentConfig.from_values(values["agent"]), clock, int(values["incarnation"]), int(values["begin"])
    except (MalformedMessage, KeyError, TypeError, ValueError) as error:
        raise JoinError(f"the answer on {keys.cfg(vehicle)} is none that this version understands: {error}") from None
