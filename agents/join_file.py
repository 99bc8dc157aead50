"""The join file of an external agent: what it must hold, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from agents.errors import AgentError
from netem.files import DamagedFile, ExposedFile, parse_json, read_private
from netem.limits import CONNECTION_FILE
from netem.whole_file import write_whole
from netem.wire.credentials import LEASE_MS, Credentials
from netem.wire.messages import PROTOCOL_VERSION

# As zenoh writes it; the socket is that of a run on this host, of this user.
ENDPOINT = re.compile(r"(tcp|tls)/(?P<host>[^?#]+):(?P<port>[0-9]{1,5})([?#].*)?|unixsock-stream/(?P<path>/[^?#]+)")
_ONE_HOST = {"ca": "", "certificate": "", "key": "", "lease_ms": LEASE_MS}  # left out of the file

Name = Annotated[str, Meta(max_length=200)]


class JoinError(AgentError):
    """A run that cannot be joined, or that ended without notice; the text says why, and what to do."""


class NotYetError(JoinError):
    """A run that cannot be joined now, perhaps later: its join file is not there, not whole, or of a run before."""


class _Version(msgspec.Struct):
    """The fields that a join file of every version has."""

    version: Any = None


class JoinFile(msgspec.Struct, frozen=True):
    endpoint: str  # where the run's router listens, as zenoh writes it; several have commas between them
    run: Name  # the run's id: its keys begin with fleet/<run>/
    vehicle: Annotated[int, Meta(ge=1)]
    user: Name
    password: Name
    version: int = PROTOCOL_VERSION
    scenario: Name = ""
    incarnation: Annotated[int, Meta(ge=0)] = 0  # which life of the agent it is
    begin: Annotated[int, Meta(ge=0)] = 0  # tick of its first nav
    ca: str = ""  # PEM, with TLS: the certificate authority to trust
    certificate: str = ""  # PEM, with its key, for a router that asks for one
    key: str = ""
    lease_ms: Annotated[int, Meta(gt=0)] = LEASE_MS  # how long the router keeps a silent link

    @property
    def credentials(self) -> Credentials:
        return Credentials(self.user, self.password, self.ca, self.certificate, self.key, self.lease_ms)

    def __repr__(self) -> str:
        return f"JoinFile({self.endpoint!r}, run={self.run!r}, vehicle={self.vehicle}, password=***)"

    def write(self, path: Path) -> None:
        """Make the file, or replace it as a whole; only this user can read it. Raises OSError: it cannot be written."""
        values = {key: value for key, value in msgspec.structs.asdict(self).items() if value != _ONE_HOST.get(key)}
        write_whole(path, (json.dumps(values, indent=2) + "\n").encode())

    @classmethod
    def read(cls, path: Path) -> JoinFile:
        """Read what `write` wrote. Raises NotYetError if the file is missing, others can read it, or it is no join
        file; JoinError if it cannot be read, or is of another protocol version.
        """
        try:
            data = read_private(path, CONNECTION_FILE.bytes)
            version = parse_json(data, _Version).version
            if version != PROTOCOL_VERSION:
                raise JoinError(
                    f"the run of {path} speaks version {version!s:.40} of the protocol, this fleet version "
                    f"{PROTOCOL_VERSION}: use the uuv-fleet that the run uses"
                )
            content = parse_json(data, cls)
        except FileNotFoundError:
            raise NotYetError(
                f"there is no {path}: a run writes it for each vehicle that is external, and removes it when it ends"
            ) from None
        except OSError as error:
            raise JoinError(f"{path} cannot be read: {error.strerror}") from None
        except ExposedFile as error:
            raise NotYetError(str(error)) from None
        except DamagedFile as error:
            raise NotYetError(f"{path} is no join file: {error}") from None
        for endpoint in content.endpoint.split(","):
            if not ENDPOINT.fullmatch(endpoint):
                known = "tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream/PATH"
                raise JoinError(f"{path}: endpoint: expected {known}, got {endpoint!r:.80}")
        for name, text in (("ca", content.ca), ("certificate", content.certificate), ("key", content.key)):
            if text and "-----BEGIN " not in text:
                raise JoinError(f"{path}: {name}: expected PEM, which has a line -----BEGIN ...-----")
        return content
