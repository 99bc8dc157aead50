"""The clock of a live run: held, stepped and let go, it never grants too much, and never goes back."""

from __future__ import annotations

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.execution.clock import GrantPolicy, LiveClock

TICKS, TICK_NS = 10_000, 10_000_000
DO = st.one_of(
    st.just(("pause", 0.0)),
    st.just(("resume", 0.0)),
    st.tuples(st.just("step"), st.integers(1, 50).map(float)),
    st.tuples(st.just("speed"), st.sampled_from([0.5, 1.0, 4.0, inf])),
    st.tuples(st.just("wait"), st.floats(0.0, 2.0)),
)


def clock(speed: float | None = None) -> LiveClock:
    return LiveClock(GrantPolicy(TICKS, TICK_NS, 10, 1, speed), 0.0)


@given(st.lists(DO, max_size=20), st.sampled_from([None, 1.0]))
def test_it_holds_and_never_goes_back(done: list[tuple[str, float]], speed: float | None) -> None:
    """A held clock grants no tick after the one at which it is held. Waiting does not change that."""
    live, now = clock(speed), 0.0
    granted = live.until(0, now)
    for what, value in done:
        match what:
            case "pause":
                live.pause(granted)
            case "resume":
                live.resume()
            case "step":
                live.step(granted, int(value))
            case "speed":
                live.set_speed_limit(granted, None if value == inf else value)
            case _:
                now += value
        until = live.until(granted, now)
        assert until <= TICKS and (not live.paused or until <= live.held)
        granted = max(granted, until)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_after_a_pause_it_goes_on_from_there(speed: float) -> None:
    """It does not catch up with the time of the pause."""
    live = clock(speed)
    written = 5000  # far ahead of what the clock grants, so that only the clock counts
    granted = live.until(written, 1.0)
    assert granted == 100 * speed + 1
    live.pause(granted)
    assert (live.paused, live.describe(), live.until(written, 60.0)) == (True, "paused", granted)
    live.resume()
    assert (live.paused, live.describe()) == (False, f"{speed:g} x real time")
    assert live.until(written, 60.5) == granted + 50 * speed + 1


def test_a_step_grants_its_ticks_and_holds_again() -> None:
    live = clock()
    live.pause(200)
    live.step(200, 25)
    assert (live.until(200, 0.0), live.until(225, 9.0)) == (225, 225)
    live.step(225, 10**9)
    assert live.held == TICKS
