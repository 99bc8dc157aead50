"""The start of the world process."""

from __future__ import annotations

import os
import threading

import pytest

from world.main import share_processor


@pytest.mark.parametrize(("processors", "kept"), [({3, 5}, True), ({3}, False), ({1, 3, 5}, False)])
def test_all_threads_share_one_of_two_processors(
    monkeypatch: pytest.MonkeyPatch, processors: set[int], kept: bool
) -> None:
    """Where there are more, they may run side by side."""
    placed: dict[int, set[int]] = {}
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: processors)
    monkeypatch.setattr(os, "sched_setaffinity", placed.__setitem__)
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()
    try:
        share_processor()
    finally:
        over.set()
        other.join()
    if not kept:
        assert placed == {}
        return
    assert {threading.get_native_id(), other.native_id} <= placed.keys()
    (where,) = {frozenset(one) for one in placed.values()}
    assert len(where) == 1
    assert where < processors
