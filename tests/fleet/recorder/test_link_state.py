"""The state of a link, by its last packets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.recorder.scene.link_state import (
    ARRIVED,
    BEHIND,
    CUT,
    DAMAGED,
    GONE,
    HISTORY,
    LinkHistory,
    LinkState,
    fate_of,
    mark_of,
    stale_after,
    state_of,
)
from netem.cause import Cause

ROUND_S = 0.1
STALE_S = stale_after(ROUND_S)


def link(*fates: str) -> LinkHistory:
    """With packets that were sent one a round, from 0 s on."""
    history = LinkHistory()
    for number, fate in enumerate(fates):
        history.settle(fate, number * ROUND_S, (number + 1) * ROUND_S)
    return history


@pytest.mark.parametrize(
    ("cause", "delay_s", "corrupted", "fate"),
    [
        ("delivered", 0.1, False, ARRIVED),
        ("delivered", 0.2, False, BEHIND),
        ("delivered", 0.1, True, DAMAGED),
        ("loss", 0.1, False, GONE),
        ("collision", 0.1, False, GONE),
        ("down", 0.1, False, CUT),
        ("dead receiver", 0.1, False, CUT),
    ],
)
def test_what_became_of_a_packet(cause: str, delay_s: float, corrupted: bool, fate: str) -> None:
    assert fate_of(cause, delay_s, corrupted, ROUND_S) == fate


@pytest.mark.parametrize(
    ("fates", "state"),
    [
        ([], LinkState.SILENT),
        ([ARRIVED], LinkState.DELIVERING),
        ([ARRIVED, BEHIND], LinkState.DELIVERING),  # half of them in time
        ([ARRIVED, BEHIND, BEHIND], LinkState.LATE),
        ([BEHIND, BEHIND, GONE, ARRIVED], LinkState.LOSING),
        ([DAMAGED, ARRIVED], LinkState.LOSING),
        ([ARRIVED, CUT], LinkState.CUT),
        ([ARRIVED] * HISTORY + [GONE] * 4, LinkState.LOSING),
        ([ARRIVED] * HISTORY + [GONE] * 5, LinkState.CUT),  # so says the scene in the log
        ([CUT, ARRIVED], LinkState.LOSING),  # it is back, and what was cut is not forgotten yet
        ([CUT] + [ARRIVED] * HISTORY, LinkState.DELIVERING),
    ],
)
def test_the_state_is_that_of_the_last_packets(fates: list[str], state: str) -> None:
    history = link(*fates)
    assert history.state(len(fates) * ROUND_S, STALE_S) == state


def test_a_link_on_which_nothing_arrives_for_long_is_stale() -> None:
    history = link(ARRIVED, GONE)
    assert history.state(0.1 + STALE_S, STALE_S) == LinkState.LOSING
    assert history.state(0.1 + STALE_S + 0.01, STALE_S) == LinkState.STALE
    assert link().state(STALE_S + 0.01, STALE_S) == LinkState.STALE  # nothing was ever sent
    assert stale_after(3.0) == 15.0  # rounds may be slow, as sound is


def test_the_age_is_of_the_newest_that_arrived() -> None:
    history = link(ARRIVED, ARRIVED, GONE)
    assert history.age_s(0.5) == pytest.approx(0.4)
    history.settle(BEHIND, 0.05, 0.5)  # older than what is known
    assert history.age_s(0.5) == pytest.approx(0.4)
    assert history.lost_of_last == 1


@given(st.lists(st.sampled_from([Cause.DELIVERED, Cause.LOSS, Cause.DOWN, Cause.PARTITION]), max_size=3 * HISTORY))
def test_log_and_page_say_the_same_of_the_same_packets(causes: list[Cause]) -> None:
    """As long as packets arrive in time and none is long ago."""
    history = link(*(fate_of(cause, ROUND_S, False, ROUND_S) for cause in causes))
    marks = "".join(mark_of(cause, corrupted=False) for cause in causes)[-HISTORY:]
    assert history.state(0.0, STALE_S) == state_of(marks)
