"""A robot that does not take what is due for it keeps its own messages waiting, within bounds, and nothing else."""

from __future__ import annotations

from functools import partial
from threading import Event
from time import monotonic_ns

from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_for

from netem.errors import BusError
from netem.limits import ROBOT_WAITING
from netem.wire.robot_queues import HandOver, Outlet

LIMIT_S = 60.0


def all_outcomes(outlet: Outlet, count: int) -> list[HandOver]:
    found: list[HandOver] = []
    wait_for(lambda: found.extend(outlet.outcomes()) or len(found) >= count, LIMIT_S, "the outcomes")
    return found


MOST = ROBOT_WAITING.bytes


@given(st.lists(st.sampled_from([0, 1, MOST // 3, MOST, 2 * MOST]), max_size=12))
def test_what_waits_for_a_stopped_robot_is_bounded_and_comes_in_order(sizes: list[int]) -> None:
    """One message of any size passes, and nothing waits behind it that exceeds the bounds."""
    outlet, goes = Outlet(), Event()
    taken, waiting = [], 0
    for number, size in enumerate(sizes):
        fits = not taken or waiting + size <= MOST
        assert outlet.offer(number, monotonic_ns(), size, lambda: goes.wait() and None) is fits
        if fits:
            taken.append(number)
            waiting += size
    assert outlet.outcomes() == []
    goes.set()
    found = all_outcomes(outlet, len(taken))
    outlet.close()
    assert [one.message for one in found] == taken
    assert all(one.delivered for one in found)
    assert all(min(one.late_ns, one.kept_ns) >= 0 for one in found)


def test_as_many_messages_wait_as_the_bound_says_and_then_there_is_room_again() -> None:
    outlet, goes = Outlet(), Event()
    offered = [outlet.offer(n, monotonic_ns(), 1, lambda: goes.wait() and None) for n in range(ROBOT_WAITING.items + 5)]
    assert offered == [True] * ROBOT_WAITING.items + [False] * 5
    goes.set()
    found = all_outcomes(outlet, ROBOT_WAITING.items)
    # Who waited behind others did so because of the robot: the host was in time.
    assert found[-1].kept_ns >= found[-1].at_ns - found[0].at_ns - found[-1].late_ns
    assert outlet.offer(0, monotonic_ns(), 1, lambda: None)
    outlet.close()


def test_what_could_not_be_handed_over_is_not_delivered() -> None:
    outlet = Outlet()

    def fails() -> None:
        raise BusError("nobody is there")

    outlet.offer("a", monotonic_ns(), 1, fails)
    outlet.offer("b", monotonic_ns(), 1, outlet.lost_link)  # its program goes meanwhile
    outlet.offer("c", monotonic_ns(), 1, lambda: None)
    found = all_outcomes(outlet, 3)
    outlet.close()
    assert [(one.message, one.delivered, one.problem) for one in found] == [
        ("a", False, "nobody is there"),
        ("b", False, ""),
        ("c", True, ""),
    ]


class Panic(BaseException):
    """As that of zenoh, which is no Exception."""


MOST = ROBOT_WAITING.bytes


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([None, BusError, ValueError, Panic])), max_size=8))
def test_nothing_that_a_job_raises_ends_the_thread_and_all_is_accounted_for(
    jobs: list[tuple[bool, type[BaseException] | None]],
) -> None:
    outlet, done = Outlet(), Event()

    def does(raises: type[BaseException] | None) -> None:
        if raises is not None:
            raise raises("it went wrong")

    for number, (is_message, raises) in enumerate(jobs):
        job = partial(does, raises)
        if is_message:
            assert outlet.offer(number, monotonic_ns(), 1, job)
        else:
            outlet.do(job)
    outlet.do(done.set)
    assert done.wait(LIMIT_S)
    said = {None: "", BusError: "it went wrong", ValueError: "ValueError: it went wrong", Panic: "Panic: it went wrong"}
    messages = [(n, said[raises], raises is None) for n, (is_message, raises) in enumerate(jobs) if is_message]
    assert [(one.message, one.problem, one.delivered) for one in outlet.outcomes()] == messages
    assert outlet.problems() == [said[raises] for is_message, raises in jobs if raises and not is_message]
    outlet.close()
