"""The state of a link, by its last packets."""

from __future__ import annotations

import pytest

from fleet.view.links import (
    ARRIVED,
    BEHIND,
    CUT,
    DAMAGED,
    DELIVERED,
    DOWN,
    GONE,
    HISTORY,
    LATE,
    LOST,
    STALE,
    UNUSED,
    LinkHistory,
    fate_of,
    stale_after,
)

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
        ([], UNUSED),
        ([ARRIVED], DELIVERED),
        ([ARRIVED, BEHIND], DELIVERED),  # half of them in time
        ([ARRIVED, BEHIND, BEHIND], LATE),
        ([BEHIND, BEHIND, GONE, ARRIVED], LOST),
        ([DAMAGED, ARRIVED], LOST),
        ([ARRIVED, CUT], DOWN),
        ([CUT, ARRIVED], LOST),  # it is back, and what was cut is not forgotten yet
        ([CUT] + [ARRIVED] * HISTORY, DELIVERED),
    ],
)
def test_the_state_is_that_of_the_last_packets(fates: list[str], state: str) -> None:
    history = link(*fates)
    assert history.state(len(fates) * ROUND_S, STALE_S) == state


def test_a_link_on_which_nothing_arrives_for_long_is_stale() -> None:
    history = link(ARRIVED, GONE)
    assert history.state(0.1 + STALE_S, STALE_S) == LOST
    assert history.state(0.1 + STALE_S + 0.01, STALE_S) == STALE
    assert link().state(STALE_S + 0.01, STALE_S) == STALE  # nothing was ever sent
    assert stale_after(3.0) == 15.0  # rounds may be slow, as sound is


def test_the_age_is_of_the_newest_that_arrived() -> None:
    history = link(ARRIVED, ARRIVED, GONE)
    assert history.age_s(0.5) == pytest.approx(0.4)
    history.settle(BEHIND, 0.05, 0.5)  # older than what is known
    assert history.age_s(0.5) == pytest.approx(0.4)
    assert history.lost_of_last == 1
