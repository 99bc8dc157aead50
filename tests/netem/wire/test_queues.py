"""What waits of a key or sender: as much as the quota, and no flood of one takes the room of another."""

from __future__ import annotations

from collections import Counter
from threading import Thread
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.limits import RELAY_WAITING
from netem.wire import robot_queues
from netem.wire.queues import Quota
from netem.wire.robot_queues import Inlet


@given(st.integers(1, 5), st.lists(st.sampled_from(["come a", "come b", "go a", "go b"]), max_size=40))
def test_a_quota_holds_for_each_key_by_itself(most: int, events: list[str]) -> None:
    quota, waiting = Quota(most), {"a": 0, "b": 0}
    for event in events:
        what, key = event.split()
        if what == "come":
            assert quota.admit(key) is (waiting[key] < most)
            waiting[key] += waiting[key] < most
        elif waiting[key]:
            quota.release(key)
            waiting[key] -= 1


@given(st.lists(st.one_of(st.integers(0, 12), st.just("go"), st.just("unfit")), max_size=60))
def test_what_enters_is_bounded_in_messages_and_bytes_and_the_rest_is_counted(events: list[Any]) -> None:
    """A message of any size enters alone; whatever does not fit is told once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot_queues, "RELAY_WAITING", RELAY_WAITING._replace(items=4, bytes=10))
        waiting: list[int] = []
        inlet, lost, told = Inlet(waiting.append), Counter[Any](), Counter[Any]()
        for event in (*events, "unfit"):
            if event == "go":
                if waiting:
                    inlet.release(waiting.pop(0))
            elif event == "unfit":
                told += inlet.unfit()
                assert told == lost
            else:
                fits = not waiting or (len(waiting) < 4 and sum(waiting) + event <= 10)
                lost[event] += not fits
                before = len(waiting)
                inlet.offer(event, event, lambda event=event: event)  # type: ignore[misc]
                assert len(waiting) == before + fits


def test_several_threads_that_let_in_exceed_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_queues, "RELAY_WAITING", RELAY_WAITING._replace(items=100))
    came: list[str] = []
    inlet = Inlet(came.append)
    threads = [Thread(target=lambda: [inlet.offer("x", 1, str) for _ in range(200)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(came) == 100
    assert inlet.unfit() == {"": 700}
    assert inlet.unfit() == {}


def test_names_of_what_does_not_fit_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_queues, "RELAY_WAITING", RELAY_WAITING._replace(items=1))
    monkeypatch.setattr(robot_queues, "_MOST_KINDS", 2)
    inlet = Inlet(lambda item: None)
    for number in range(6):
        inlet.offer(number, 1, lambda number=number: number)  # type: ignore[misc]
    assert inlet.unfit() == {1: 1, 2: 1, None: 3}
