"""The common beginning of our zenoh sessions: their configuration, the file of their users, zenoh's own log."""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import zenoh

from netem.whole_file import write_whole
from netem.wire.credentials import LEASE_MS, Credentials, Listener
from netem.wire.listening import socket_place

# A send that waits blocks its thread, and zenoh starts another one. If all 50 threads of zenoh's default wait, nothing
# moves any more. This happened to a router of 1,000 vehicles on a busy machine. With more room it had up to 769.
THREADS = 4096
# ZENOH_RUNTIME, which zenoh reads when the first session of a process opens; it panics if that is malformed.
# There is one thread instead of five pools: a process has few sessions, and the pools would wake each other (bare
# barrier, N = 4: 165 us per tick against 290). With `lowlatency` the calling thread sends. So a receive task that waits
# for a full channel does not delay a send.
RUNTIME = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), "
    f"app: (worker_threads: 1, max_blocking_threads: {THREADS}))"
)
# The low-latency transport cannot fragment: a longer message vanishes without a word.
PIECE_BYTES = 65_535  # what zenoh sends in one piece, at most
_TLS = "transport/link/tls"

# Puts block and are reliable, which is zenoh's default for them: DROP loses messages silently. Grants limit the number
# of messages under way.
BASE: dict[str, Any] = {
    # A run is a closed box.
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "adminspace/enabled": False,
    # Otherwise a router waits half a second for other routers before its session is open.
    "scouting/delay": 0,
    # 20-40 % less per round trip; our messages have one priority.
    "transport/unicast/lowlatency": True,
    "transport/unicast/qos/enabled": False,
    # One hour on loopback. With the default of 10 s a process that was only suspended loses its messages silently, and
    # reconnects as if nothing had happened. A dead process shows by its exit and its closed socket. Between hosts
    # somebody may pull a cable, and that closes no socket. There the lease is short, and `Bus.on_lost` reports its end.
    "transport/link/tx/lease": LEASE_MS,
    # With zenoh's default any client could make the world hold 1 GiB. Our messages fit into one piece. The router drops
    # a longer message of several pieces, and cuts off a client that announces a longer piece. (Measured with 100 MB:
    # the world grew by 200 MB before, and does not grow now.)
    "transport/link/rx/max_message_size": PIECE_BYTES,
    # Our messages are far below its threshold, and it starts threads.
    "transport/shared_memory/enabled": False,
}

# Zenoh's own transport: it sends from a task of its own, and cuts long messages into pieces.
UNIVERSAL: dict[str, Any] = {"transport/unicast/lowlatency": False}

# Traffic of others that is played or recorded: a message may be an image or a point cloud.
# Zenoh drops longer messages without a word; a recorder counts those that are too long for a log.
OTHERS = {"transport/link/rx/max_message_size": 256 << 20}

# A connection that has not logged in holds one of PENDING places, for PENDING_MS. All listeners share the places.
PENDING = 1000
PENDING_MS = 5000


def router_settings(vehicles: int, lease_ms: int) -> dict[str, Any]:
    """Settings of the router of a run with this number of vehicles; without users and endpoints."""
    return BASE | {
        "transport/link/tx/lease": lease_ms,
        # A fleet of 100 connects at once; zenoh refuses what exceeds this.
        "transport/unicast/accept_pending": max(PENDING, 2 * vehicles),
        "transport/unicast/accept_timeout": PENDING_MS,
        "transport/unicast/max_sessions": 1000 + vehicles,
    }


def client_settings(endpoints: list[str], credentials: Credentials | None, timeout_ms: int) -> dict[str, Any]:
    """Settings of a session that joins a router."""
    settings: dict[str, Any] = {
        "connect/endpoints": endpoints,
        "connect/timeout_ms": timeout_ms,
        "connect/exit_on_failure": True,
        # Everyone starts at once; zenoh's own first retry comes after a whole second.
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
    }
    if credentials is not None:
        settings["transport/auth/usrpwd/user"] = credentials.user
        settings["transport/auth/usrpwd/password"] = credentials.password
    return settings


def client_tls(credentials: Credentials) -> dict[str, Any]:
    """PEM goes into the session as it is, by way of base64: no file of it is needed."""
    settings: dict[str, Any] = {}
    if credentials.ca:
        settings[f"{_TLS}/root_ca_certificate_base64"] = _base64(credentials.ca)
    if credentials.certificate:
        settings[f"{_TLS}/enable_mtls"] = True
        settings[f"{_TLS}/connect_certificate_base64"] = _base64(credentials.certificate)
        settings[f"{_TLS}/connect_private_key_base64"] = _base64(credentials.key)
    return settings


def server_tls(listener: Listener, *, mutual: bool) -> dict[str, Any]:
    """The other side of `client_tls`; empty when the listener has no certificate. `mutual`: whether everybody has to
    show a certificate.
    """
    settings: dict[str, Any] = {}
    if listener.certificate:
        settings[f"{_TLS}/root_ca_certificate_base64"] = _base64(listener.ca)
        settings[f"{_TLS}/listen_certificate_base64"] = _base64(listener.certificate)
        settings[f"{_TLS}/listen_private_key_base64"] = _base64(listener.key)
        settings[f"{_TLS}/enable_mtls"] = mutual
    return settings


def listening(endpoints: list[str]) -> dict[str, Any]:
    """Settings of a router: where it listens, or fails at once."""
    return {"listen/endpoints": endpoints, "listen/exit_on_failure": True, "listen/timeout_ms": 0}


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


# Ours, whatever the environment says: zenoh has not read it yet.
os.environ["ZENOH_RUNTIME"] = RUNTIME


def open_session(mode: Literal["client", "router"], settings: dict[str, Any]) -> zenoh.Session:
    """A session with `netem.wire.session.BASE`, changed by `settings`. Raises zenoh.ZError if it cannot be opened."""
    config = zenoh.Config()
    for key, value in ({"mode": mode} | BASE | settings).items():
        config.insert_json5(key, json.dumps(value))
    return session_of(config)


def session_of(config: zenoh.Config) -> zenoh.Session:
    """A session of a configuration. Raises zenoh.ZError if it cannot be opened, or would remove a file to listen."""
    for path in re.findall(r'"unixsock-stream/([^"?#]+)', config.get_json("listen/endpoints")):
        if wrong := socket_place(Path(json.loads(f'"{path}"'))):
            raise zenoh.ZError(wrong)
    try:
        return zenoh.open(config)
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # of pyo3, which exports no class; its base is BaseException
            raise
        raise zenoh.ZError(f"zenoh cannot begin ({error}): is there a descriptor and a thread left?") from None


def users_file(private: Path, credentials: Iterable[Credentials]) -> Path:
    """Write the file that lists who may log in. The router reads it once. `private`: a directory of mode 0700. Raises
    OSError if it cannot be written.
    """
    users = private / "users"
    write_whole(users, "".join(f"{c.user}:{c.password}\n" for c in credentials).encode())
    return users


def reason(error: Exception) -> str:
    """The first line of what zenoh says, without the places in its source."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return re.sub(r" at /\S+\.rs:\d+\.", "", text)


def log_zenoh(levels: str) -> None:
    """Send zenoh's own log to stdout, with these levels unless RUST_LOG gives others; once per process."""
    zenoh.init_log_from_env_or(levels)


def quiet_zenoh() -> None:
    """Log errors of zenoh only, unless RUST_LOG says otherwise, and none that a BusError reports."""
    log_zenoh("error,zenoh_transport::unicast::establishment=off")
