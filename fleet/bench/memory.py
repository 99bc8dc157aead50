"""How much memory the processes of a run share out between them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import psutil


@contextmanager
def sampled_pss() -> Iterator[list[float]]:
    """Largest mean proportional set size [MB] of the agent processes seen inside the block, in a list."""
    largest = [0.0]
    done = threading.Event()

    def sample() -> None:
        while not done.wait(0.5):
            if sizes := [size for size in map(pss_mb, _agents()) if size]:
                largest[0] = max(largest[0], sum(sizes) / len(sizes))

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield largest
    finally:
        done.set()
        thread.join()


def _agents() -> Iterator[int]:
    for process in psutil.process_iter(["cmdline"]):
        if " ".join(process.info["cmdline"] or []).startswith("fleet agent"):
            yield process.pid


def pss_mb(pid: int) -> float:
    """A process's own memory and its part of what it shares (PSS); 0 if it has ended."""
    try:
        return float(psutil.Process(pid).memory_full_info().pss) / 1e6
    except psutil.Error:
        return 0.0
