"""Where the system gives no thread: said in words, and no process is left."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from fleet.errors import RunBroken
from fleet.processes.children import Children


def none_left(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_a_process_that_cannot_be_waited_for_is_not_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    children = Children(lambda _: None)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", none_left)
        with pytest.raises(RunBroken, match=r"cannot start a thread .*ulimit -u.*--in-process"):
            children.start("a", "fleet test", tmp_path / "a.log", os.getpid)
    assert children.by_role == {}
    children.stop()


def test_processes_end_also_where_nobody_could_watch_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To end them had failed, since the thread that watches them had not begun; and the command hung."""
    children = Children(lambda _: None)
    children.start("a", "fleet test", tmp_path / "a.log", signal.pause)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", none_left)
        with pytest.raises(RunBroken, match="cannot start a thread"):
            children.watch()
        children.stop()
    assert not children.by_role["a"].process.is_alive()
