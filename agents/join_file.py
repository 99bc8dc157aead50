"""The join file of an external agent: what it must hold, and what is refused."""

from __future__ import annotations

import json
import os
import re
import stat
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from agents.errors import AgentError
from netem.whole_file import open_file, read_bounded, write_whole
from netem.wire.access import LEASE_MS, Credentials
from netem.wire.messages import PROTOCOL_VERSION

MAX_TEXT = 200  # characters of a name or password
MAX_BYTES = 1_000_000  # of a join file, with certificates
# As zenoh writes it; the socket is that of a run on this host, of this user.
ENDPOINT = re.compile(r"(tcp|tls)/(?P<host>[^?#]+):(?P<port>[0-9]{1,5})([?#].*)?|unixsock-stream/(?P<path>/[^?#]+)")
_ONE_HOST = {"ca": "", "certificate": "", "key": "", "lease_ms": LEASE_MS}  # left out of the file


class JoinError(AgentError):
    """A run that cannot be joined, or that ended without notice; the text says why, and what to do."""


@dataclass(frozen=True, slots=True)
class JoinFile:
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
    certificate: str = ""  # PEM, with its key, for a router that asks for one
    key: str = ""
    lease_ms: int = LEASE_MS  # how long the router keeps a silent link

    @property
    def credentials(self) -> Credentials:
        """What the agent presents to the router."""
        return Credentials(self.user, self.password, self.ca, self.certificate, self.key, self.lease_ms)

    def __repr__(self) -> str:
        return f"JoinFile({self.endpoint!r}, run={self.run!r}, vehicle={self.vehicle}, password=***)"

    def write(self, path: Path) -> None:
        """Make the file, or replace it as a whole; only this user can read it.

        Raises:
            OSError: it cannot be written.
        """
        values = {key: value for key, value in asdict(self).items() if value != _ONE_HOST.get(key)}
        write_whole(path, (json.dumps(values, indent=2) + "\n").encode())

    @classmethod
    def read(cls, path: Path) -> JoinFile:
        """Read what `write` wrote.

        Raises:
            JoinError: the file is missing, others can read it, it is no join file, or of another protocol version.
        """
        try:
            with open_file(path) as file:
                mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
                data = read_bounded(file, MAX_BYTES)
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
            if not ENDPOINT.fullmatch(endpoint):
                known = "tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream/PATH"
                raise JoinError(f"{path}: endpoint: expected {known}, got {endpoint!r:.80}")
        for key in ("ca", "certificate", "key"):
            if values.get(key) and "-----BEGIN " not in values[key]:
                raise JoinError(f"{path}: {key}: expected PEM, which has a line -----BEGIN ...-----")
        return cls(version=version, **{key: values[key] for key in (*fields, *optional) if key in values})


def _check(path: Path, key: str, kind: type, value: Any) -> None:
    if type(value) is not kind:
        raise JoinError(f"{path}: {key}: expected {kind.__name__}, got {type(value).__name__}")
    if isinstance(value, str) and len(value) > MAX_TEXT and key not in ("endpoint", "ca", "certificate", "key"):
        raise JoinError(f"{path}: {key}: {len(value)} characters, expected at most {MAX_TEXT}")
