"""Runs in whose processes the system refuses a thread, each process its nth: status 3, words, nobody left."""

from __future__ import annotations

import os
from pathlib import Path
from textwrap import dedent

import pytest
from ended_runs import LONG
from live import LiveRun

REFUSING = """
    import os, threading
    start, seen = threading.Thread.start, [0, os.getpid()]

    def refusing(self):
        if os.getpid() != seen[1]:
            seen[:] = 0, os.getpid()
        seen[0] += 1
        if seen[0] >= {first}:
            raise RuntimeError("can't start new thread")
        start(self)

    threading.Thread.start = refusing
"""


@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 3, 5, 6, 8])
def test_a_run_ends_that_gets_no_more_threads(first: int, tmp_path: Path) -> None:
    """From the sixth on it had hung: the session of zenoh could not be closed without a thread."""
    (tmp_path / "sitecustomize.py").write_text(dedent(REFUSING.format(first=first)), "utf-8")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    with LiveRun(tmp_path / "runs", "paper", *LONG, environment={"PYTHONPATH": path}) as run:
        run.ends(3)
        assert "cannot start a thread" in run.said and "ulimit -u" in run.said
