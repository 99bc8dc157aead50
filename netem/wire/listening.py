"""Whether zenoh could listen at an address: seen before anything is started."""

from __future__ import annotations

import socket


def probe_address(host: str, port: int) -> None:
    """Bind a TCP socket there for a moment, as zenoh's listener will. Raises OSError if the port is taken or not for
    this user, or the address is not of this host.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, protocol) as probe:
        # As zenoh's listener does: a port whose last connections are still winding down is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)
