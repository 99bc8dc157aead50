"""The common beginning of our zenoh sessions: their configuration, the file of their users, zenoh's own log."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import zenoh

from netem.whole_file import write_whole
from netem.wire.access import Credentials
from netem.wire.settings import BASE, RUNTIME

# Ours, whatever the environment says: zenoh has not read it yet.
os.environ["ZENOH_RUNTIME"] = RUNTIME


def open_session(mode: Literal["client", "router"], settings: dict[str, Any]) -> zenoh.Session:
    """A session with `netem.wire.settings.BASE`, changed by `settings`.

    Raises:
        zenoh.ZError: it cannot be opened.
    """
    config = zenoh.Config()
    for key, value in ({"mode": mode} | BASE | settings).items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def users_file(private: Path, credentials: Iterable[Credentials]) -> Path:
    """Write the file that lists who may log in. The router reads it once.

    Args:
        private: a directory of mode 0700.

    Raises:
        OSError: it cannot be written.
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
