"""How the processes of a run find each other, and what protects them on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from netem.whole_file import write_whole
from netem.wire.credentials import Credentials, Listener, agent_role
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION

# The files of a join folder. They are plain, so that a program in C reads them without a parser.
CONF, CA, CERTIFICATE, KEY = "join.conf", "ca.pem", "certificate.pem", "key.pem"


@dataclass(frozen=True, slots=True)
class JoinFolder:
    """The folder `join-<i>` of one agent: `join.conf`, which is lines of a name and a value, and three PEM files."""

    vehicle: int
    endpoints: tuple[str, ...]
    lease_ms: int
    ca: str  # PEM
    pair: KeyPair

    def write(self, path: Path, keys: Keys, incarnation: int, begin: int) -> None:
        """Make the folder, or replace its files one by one; only this user can enter it. Raises OSError.

        `incarnation`: which life of the agent is to join; `begin`: tick of its first nav.
        """
        i, role = self.vehicle, agent_role(self.vehicle)
        lines = [
            ("version", PROTOCOL_VERSION),
            *(("endpoint", endpoint) for endpoint in self.endpoints),
            ("lease_ms", self.lease_ms),
            ("run", keys.run),
            ("vehicle", i),
            ("incarnation", incarnation),
            ("begin", begin),
            ("cfg", keys.cfg(i)),
            ("nav", keys.nav(i)),
            ("rx", keys.rx(i)),
            ("cmd", keys.cmd(i)),
            ("tx", keys.tx(i)),
            ("note", keys.note(role)),
            ("alive", keys.alive(role)),
        ]
        path.mkdir(mode=0o700, exist_ok=True)
        write_whole(path / CA, self.ca.encode())
        write_whole(path / CERTIFICATE, self.pair.certificate.encode())
        write_whole(path / KEY, self.pair.key.encode())
        write_whole(path / CONF, "".join(f"{name} {value}\n" for name, value in lines).encode())


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A certificate and its private key, PEM."""

    certificate: str
    key: str = field(repr=False)


@dataclass(frozen=True, slots=True)
class Rendezvous:
    """How the processes of one run find each other, and what protects them on the way."""

    run: str | None = None  # the run's id, where a router has to know it beforehand
    router: str | None = None  # endpoint of a router that is there already; None: the world hosts one
    credentials: dict[str, Credentials] | None = None  # by role; None: fresh ones
    listener: Listener | None = None  # where the run's own router listens for other hosts
    reached: str = ""  # endpoints for join files, with commas between them; empty: this host's
    ca: str = ""  # PEM: goes into join files
    certificates: dict[str, KeyPair] = field(default_factory=dict)  # for external agents, by role
    certified: Listener | None = None  # where the run listens for agents that have a certificate and no password
    folders: dict[int, JoinFolder] = field(default_factory=dict)  # what these join with, by vehicle
    lease_ms: int | None = None  # between hosts; None on one host
    warnings: tuple[str, ...] = ()

    def external_credentials(self, role: str, known: Credentials) -> Credentials:
        """The credentials of an external agent, made from those for this host."""
        own = self.certificates.get(role, KeyPair("", ""))
        lease_ms = known.lease_ms if self.lease_ms is None else self.lease_ms
        return Credentials(known.user, known.password, self.ca, own.certificate, own.key, lease_ms)
