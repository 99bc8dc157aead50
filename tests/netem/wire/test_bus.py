"""The session of a process, where zenoh itself is not needed."""

from __future__ import annotations

import subprocess
import sys
import threading
from typing import Any

import pytest

from netem.wire.bus import Bus


class Session:
    closed = False

    def close(self) -> None:
        self.closed = True


def none_left(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_it_closes_also_where_the_system_has_no_thread_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """It had failed, and the open session then kept the process from ending."""
    session: Any = Session()
    bus = Bus(session, "tcp/nowhere")
    monkeypatch.setattr(threading.Thread, "start", none_left)
    bus.close()
    assert session.closed


def test_a_session_without_a_thread_that_could_close_it_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    session: Any = Session()
    monkeypatch.setattr(threading.Thread, "start", none_left)
    with pytest.raises(RuntimeError, match="can't start new thread"):
        Bus(session, "tcp/nowhere")
    assert session.closed


def test_a_process_without_a_free_descriptor_says_so() -> None:
    """Zenoh ends with a panic, which is no Exception."""
    code = (
        "import os, resource\nfrom netem.errors import BusError\nfrom netem.wire.open_bus import OpenBus\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir('/proc/self/fd')) - 1,) * 2)\n"
        "try: OpenBus.listen('tcp/127.0.0.1:0')\n"
        "except BusError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, "descriptor" in done.stdout) == (0, True), done.stderr
