"""Things that all workers share: the first worker whose tests need one makes it."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


@contextmanager
def alone(factory: pytest.TempPathFactory, name: str) -> Iterator[Path]:
    """The path of a thing that all workers share, and that no other worker makes meanwhile."""
    base = factory.getbasetemp()
    place = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    with place.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield place


def made_once(factory: pytest.TempPathFactory, key: object, make: Callable[[Path], T]) -> T:
    """What `make` returns for a new folder, pickled there for all workers. If it fails, the next worker tries again.

    The folder belongs to the session, not to the checkout: a result never outlives the sources that made it, so the
    key needs no hash of them.

    Args:
        factory: Of the session.
        key: Distinguishes it from everything else that is made once; equal keys have equal texts.
        make: Makes it in the folder, to which nobody writes afterwards.
    """
    name = f"made-{sha256(repr(key).encode()).hexdigest()[:16]}"
    with alone(factory, name) as folder:
        result = folder / "result.pickle"
        if not result.exists():
            folder.mkdir(exist_ok=True)
            made = make(folder)
            part = result.with_suffix(".part")
            part.write_bytes(pickle.dumps(made))
            part.rename(result)
        loaded: T = pickle.loads(result.read_bytes())
        return loaded
