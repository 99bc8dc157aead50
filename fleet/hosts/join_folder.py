"""The data that an agent needs to join with a certificate alone, as plain files.

A program in C reads them without a parser.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fleet.hosts.certificates import KeyPair
from netem.whole_file import write_whole
from netem.wire.access import agent_role
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION

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
        """Make the folder, or replace its files one by one; only this user can enter it.

        Args:
            keys: of the run.
            incarnation: which life of the agent is to join.
            begin: tick of its first nav.

        Raises:
            OSError: it cannot be written.
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
