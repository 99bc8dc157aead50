"""A process ends when its link to a router on another host does."""

from __future__ import annotations

import os
import sys

from netem.wire.bus import Bus
from netem.wire.credentials import LEASE_MS, Credentials

LINK_LOST = 71  # exit status: the link to a router on another host has ended


def end_with_link(bus: Bus, credentials: Credentials) -> None:
    """Between hosts, end this process when its link to the router has ended: zenoh would make another one by itself,
    and what was on the way would be missing without a word. On one host the console sees the end of a process.
    """

    def end() -> None:
        print(f"the link to the router at {bus.endpoint} has ended: closed, or silent for the lease", file=sys.stderr)
        sys.stderr.flush()
        os._exit(LINK_LOST)

    if credentials.lease_ms < LEASE_MS:
        bus.on_lost(end)
