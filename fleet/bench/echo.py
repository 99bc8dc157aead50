"""The processes of the barrier benchmarks: they answer and compute nothing."""

from __future__ import annotations

from multiprocessing.connection import Connection

from netem.wire.access import Credentials
from netem.wire.bus import Bus
from netem.wire.keys import Keys


def echo_bus(endpoint: str, run_id: str, vehicle: int, credentials: Credentials) -> None:
    """Send every nav back as a command."""
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    put = bus.publisher(keys.cmd(vehicle))
    channel = bus.channel(keys.nav(vehicle))
    while True:
        put(channel.get()[1])


def echo_pipe(connection: Connection[bytes, bytes]) -> None:
    """Send every message back."""
    while True:
        try:
            connection.send_bytes(connection.recv_bytes())
        except (EOFError, ConnectionError):
            return
