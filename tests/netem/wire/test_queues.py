"""What waits on a key: as many as the quota, and no flood of one key takes the room of another."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netem.wire.queues import Quota


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
