"""Free loopback ports."""

from __future__ import annotations

import secrets

from fleet.errors import RunBroken
from netem.wire.listening import probe_address


def free_port(wanted: int | None) -> int:
    """A loopback port that is free now: the wanted one, or any. Another process may take it before the world does; to
    make that rare, the search begins below the range of outgoing connections. Raises RunBroken if the wanted port is
    taken.
    """
    problem = ""
    for port in [wanted] if wanted else [secrets.randbelow(22_000) + 10_000 for _ in range(100)]:
        try:
            probe_address("127.0.0.1", port)
        except OSError as error:
            problem = f"port {port} on 127.0.0.1 cannot be used ({error.strerror})"
        else:
            return port
    raise RunBroken(f"{problem}; choose another with --port, or leave it out for a free one")
