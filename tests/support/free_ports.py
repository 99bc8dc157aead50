"""Ports of this host that are free."""

from __future__ import annotations

import socket

_given: set[int] = set()


def free_port() -> int:
    """A free port that was not given before: the system gives one again as soon as nobody has it."""
    while True:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port: int = probe.getsockname()[1]
        if port not in _given:
            _given.add(port)
            return port
